"""Puts what the runs in results/ say into the documentation: ``python -m analysis.findings``.

It refills the tables of docs/findings.md and docs/evidence.md, and draws their figures. A table
stands below a comment that names it; everything else is written by hand, and read again after each
refill.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from analysis import instruments, placements, survival
from analysis.comparisons import claims, writers_table
from analysis.protocol import (
    RANDOM,
    RULE,
    best_table,
    changes_table,
    held,
    means,
    predicted,
    predictions_figure,
    predictions_table,
    sets_figure,
    sets_table,
    traits_table,
)
from analysis.runs import RUNS, runs_of, stress_of
from analysis.stand_in import beside_table, stand_in_table
from analysis.verdicts import verdicts_table
from needlehoop.runs.files import STRESS
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data import paper
from needlehoop.study.data.paper import reward_label, reward_order
from needlehoop.study.render.style import save, styled
from needlehoop.study.render.table import Table, p_value, percent, written
from needlehoop.study.report.tables import TO_SOON, result_row
from needlehoop.study.stats.findings import StudyFindings, study_findings
from needlehoop.study.stats.predictions import (
    MEASURED,
    PAPERS_MEASURED,
    Prediction,
    predictions,
    scored,
)
from needlehoop.study.stats.run import (
    BEST,
    CHEAT,
    HUMAN_POINTS,
    RETURN,
    SUCCESS,
    SUCCESS_OVER_TRAINING,
    TRAINING,
)

ROOT = Path(__file__).parents[1]
DOCS, RESULTS = ROOT / "docs", ROOT / "results"

STUDIES = ("fast", "table2", "rewards")

NEEDLE = "success with the needle"
"""What Q1's success is called where it predicts what the peg transfer's runs gave."""

IMITATED = "imitation"
"""The protocol's runs, where their success predicts what earlier studies measured."""

_PROTOCOLS = {"0.5 M": "fast", "1.5 M": "table2"}
"""Studies that stand beside each other on the page, by how many steps their agents train."""

_MEASURED = {
    f"{steps}{suffix}": (study, truth)
    for steps, study in _PROTOCOLS.items()
    for truth, suffix in ((MEASURED, ""), (TRAINING, ", over training"))
} | {"the paper's": ("table2", PAPERS_MEASURED)}
"""What predictions are held against: a column's name, the study, and what of it was measured."""

_OVER_TRAINING = {RETURN: "return", TRAINING: "over training"}
"""What the page calls the returns that it compares."""

_REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")
"""Camera sets that were trained with every reward."""


def refilled(name: str, page: str) -> str:
    """A page of ``TABLES`` with today's tables; ``ValueError`` if one has no place in it."""
    for marker, table in TABLES[name]().items():
        head = f"<!-- {marker} -->\n"
        before, separator, after = page.partition(head)
        if not separator:
            raise ValueError(f"{name}: no table {marker}")
        _, end, after = after.partition("\n\n")
        page = before + head + Table(marker, "", table).markdown() + end[1:] + after
    return page


@cache
def study(name: str) -> StudyFindings:
    """What the runs of a study of results/ say."""
    return study_findings(RESULTS / name)


@cache
def runs(name: str) -> pd.DataFrame:
    """The runs of one of docs/protocol.md's studies, by its folder in results/."""
    return runs_of(RESULTS / name)


def learnt(name: str) -> pd.DataFrame:
    """The runs of a study by PPO, with the share that each threads by friction alone."""
    run = ["cameras", "reward", "seed"]
    flown = pd.read_csv(RESULTS / name / "friction.csv").rename(columns={"success": "friction"})
    return runs(name).merge(flown[[*run, "friction"]], "left", run, validate="one_to_one")


@cache
def camera_predictions() -> list[Prediction]:
    """Who predicted the protocol's camera sets."""
    return predictions(None, RESULTS / "protocol", [*paper.lists().values()], papers=True)


def peg_predictions() -> list[Prediction]:
    """Who predicted the same camera sets for the peg transfer: a model, and the needle's runs."""
    table = pd.read_csv(RECORDINGS / "claude_peg_transfer" / "rankings.csv")
    orders = [
        dict(zip(rows["cameras"], -rows["place"], strict=True)) for _, rows in table.groupby("list")
    ]
    needle = scored(NEEDLE, means(runs("protocol")), paper.lists().values())
    return [Prediction("claude", {frozenset(order): order for order in orders}), needle]


def _results() -> pd.DataFrame:
    """The fast protocol's camera sets, the best first, with what else was measured of them.

    That is the paper's protocol as far as it has been run, and the paper's own returns. Success is
    given seed by seed: two seeds of one set can be far apart.
    """
    longer, published = {one.cameras: one for one in study("table2").ranked}, paper.measured()
    rows = []
    for result in study("fast").ranked:
        row = {
            "cameras": result.cameras,
            "threaded, %": percent(result.middle(SUCCESS)),
            "by seed": percent(result.values(SUCCESS)),
            "return": written(result.middle(RETURN)),
            "over training": written(result.middle(TRAINING)),
            "cheat, %": percent(result.middle(CHEAT)),
        }
        end = longer.get(result.cameras)
        row["1.5 M: threaded, %"] = percent(end and end.middle(SUCCESS))
        row["1.5 M: return"] = written(end and end.middle(RETURN))
        row["1.5 M: over training"] = written(end and end.middle(TRAINING))
        row["the paper's return"] = written(published.get(result.cameras))
        rows.append(row)
    return pd.DataFrame(rows)


def _claims() -> pd.DataFrame:
    columns = {
        f"{steps}: {label} (95 %)": claims(study(name), measure)
        for steps, name in _PROTOCOLS.items()
        for measure, label in _OVER_TRAINING.items()
    }
    rows = [
        {
            "the paper says": claim.text,
            "its returns": "{:.2f} / {:.2f}".format(*claim.published),
            **{column: written(values.get(claim), "+.2f") for column, values in columns.items()},
        }
        for claim in next(iter(columns.values()))
    ]
    return pd.DataFrame(rows)


def _predictions() -> pd.DataFrame:
    """Each prediction against the earlier studies: tau-b, p within classes, regret.

    The protocol's runs predict them, too.
    """
    cells: dict[str, dict[str, str]] = {}
    imitated = scored(IMITATED, means(runs("protocol")), paper.lists().values())
    for column, (name, truth) in _MEASURED.items():
        measured = study(name).truths[truth]
        rankings = [*study(name).predictions_of(truth), imitated]
        for source, lists in predicted(rankings).items():
            tau, p, lost = held(source, lists, measured)
            texts = (written(tau), "" if p is None else f"p {p_value(p)}", f"loses {lost:.2f}")
            cells.setdefault(source, {})[column] = ", ".join(filter(None, texts))
    ordered = [source for source in cells if source not in (RULE, RANDOM)] + [RULE, RANDOM]
    rows = [
        {"prediction": source} | {column: cells[source].get(column, "") for column in _MEASURED}
        for source in ordered
    ]
    return pd.DataFrame(rows)


def _rewards() -> pd.DataFrame:
    """Each reward's runs, in the order of ``_REWARDED``, by what compares across rewards."""
    results = {(one.reward, one.cameras): one for one in study("rewards").results}
    columns = ("success, %", f"{BEST}, %", HUMAN_POINTS, "cheat, %", f"{SUCCESS_OVER_TRAINING}, %")
    rows = []
    for reward in sorted({reward for reward, _ in results}, key=reward_order):
        group = [result_row(results[reward, cameras]) for cameras in _REWARDED]
        cells = {key: ", ".join(row[key] for row in group) for key in (*columns, TO_SOON)}
        rows.append({"reward": reward_label(reward)} | cells)
    return pd.DataFrame(rows)


def _verdicts() -> dict[str, pd.DataFrame]:
    written_rewards = runs("protocol_rewards")
    ways = runs("protocol"), pd.read_csv(RESULTS / "ppo" / RUNS), runs("operating_room")
    return {"verdicts": verdicts_table(*ways, written_rewards, study)}


@cache
def _evidence() -> dict[str, pd.DataFrame]:
    imitated, ppo, mounted = runs("protocol"), learnt("ppo"), runs("operating_room")
    # Both were made before the sets with cameras on instruments were trained.
    foretold = {
        "claude": instruments.model_scores(RECORDINGS / "claude_operating_room"),
        "probe": instruments.probe_scores(RESULTS / "operating_room"),
    }
    singles, pairs = runs("placements"), runs("placement_pairs")
    pegs, written_rewards = runs("peg_transfer_wide"), runs("protocol_rewards")
    tested, stress = runs("survival"), stress_of(RESULTS / "survival")
    return {
        "stand_in": beside_table(ppo, imitated),
        "stand_in_agrees": stand_in_table(ppo, imitated),
        "mounted": instruments.views_table(mounted),
        "mounted_questions": instruments.questions_table(mounted),
        "mounted_predictions": instruments.predictions_table(foretold, mounted),
        "mounted_ppo": beside_table(learnt("operating_room_ppo"), mounted),
        "mounted_pegs": sets_table(runs("operating_room_pegs"), "placed"),
        "mounted_axes": survival.axes_table(pd.read_csv(RESULTS / "operating_room" / STRESS)),
        "protocol": sets_table(imitated),
        "protocol_best": best_table(imitated),
        "protocol_traits": traits_table(imitated),
        "protocol_changes": changes_table(imitated),
        "protocol_predictions": predictions_table(camera_predictions(), means(imitated)),
        "pegs": sets_table(pegs, "placed"),
        "pegs_traits": traits_table(pegs),
        "pegs_changes": changes_table(pegs),
        "pegs_predictions": predictions_table(peg_predictions(), means(pegs)),
        "places": placements.places_table(singles),
        "placements": placements.predictions_table(placements.single_scores(), singles),
        "pairs": placements.places_table(pairs),
        "pairs_predictions": placements.predictions_table(placements.pair_scores(singles), pairs),
        "survival": survival.sets_table(tested, survival.survival(stress)),
        "survival_axes": survival.axes_table(stress),
        "survival_predicted": survival.predictions_table(tested, stress),
        "writers": writers_table(written_rewards),
        "results": _results(),
        "claims": _claims(),
        "predictions": _predictions(),
        "rewards": _rewards(),
    }


TABLES = {"findings.md": _verdicts, "evidence.md": _evidence}
"""What makes each page's tables, by the comments above them."""

FIGURES: Mapping[str, Callable[[], Figure]] = {
    "mounted": lambda: instruments.views_figure(runs("operating_room")),
    "which_cameras": lambda: sets_figure(runs("protocol")),
    "predictions": lambda: predictions_figure(camera_predictions(), means(runs("protocol"))),
    "where_cameras": lambda: placements.places_figure(runs("placements"), runs("placement_pairs")),
    "survival": lambda: survival.survival_figure(
        survival.survival(stress_of(RESULTS / "survival"))
    ),
}
"""PNG files of docs/."""


def main() -> None:
    """Refill the pages, draw figures."""
    for name in TABLES:
        page = DOCS / name
        page.write_text(refilled(name, page.read_text()))
    for name, figure in FIGURES.items():
        with styled():
            save(figure(), DOCS / name)
    print(f"refilled {', '.join(TABLES)}")


if __name__ == "__main__":
    main()
