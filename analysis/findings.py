"""Puts what the runs in results/ say into the documentation: ``python -m analysis.findings``.

It refills the tables of docs/evidence.md and draws the figures of docs/findings.md. A table of the
page stands below a comment that names it; everything else is written by hand, and read again after
each refill.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from analysis import placements, survival
from analysis.comparisons import claims
from analysis.protocol import (
    BLIND,
    RULE,
    changes_table,
    foretold_figure,
    foretold_table,
    held,
    means,
    predicted,
    sets_figure,
    sets_table,
    traits_table,
)
from analysis.runs import runs_of, stress_of
from analysis.writers import writers_table
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data import paper
from needlehoop.study.data.paper import reward_label
from needlehoop.study.render.style import save, styled
from needlehoop.study.render.table import Cell, Column, Table
from needlehoop.study.report.tables import TO_SOON, soon
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
PAGE = ROOT / "docs" / "evidence.md"
PROTOCOL = ROOT / "results" / "protocol"

STUDIES = ("fast", "table2", "rewards")

PEGS, NEEDLE = "protocol_peg_transfer", "success with the needle"
"""The protocol's study of another task, and what Q1's success is called where it predicts that."""

PAIRS = "placement_pairs"
"""Two of the cameras at random places."""

IMITATED = "imitation"
"""The protocol's runs, where their success predicts what earlier studies measured."""

_PROTOCOLS = {"0.5 M": "fast", "1.5 M": "table2"}
"""Studies that stand beside each other on the page, by how many steps their agents train."""

_MEASURED = {
    f"{steps}{said}": (study, truth)
    for steps, study in _PROTOCOLS.items()
    for truth, said in ((MEASURED, ""), (TRAINING.name, ", over training"))
} | {"the paper's": ("table2", PAPERS_MEASURED)}
"""What predictions are held against: a column's name, the study, and what of it was measured."""

_OVER_TRAINING = {RETURN: "return", TRAINING: "over training"}
"""What the page calls the returns that it compares."""

_REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")
"""Camera sets that were trained with every reward."""


def refilled(page: str) -> str:
    """The page with the tables of today's runs.

    Raises:
        ValueError: a table has no place in it.
    """
    for marker, table in TABLES.items():
        head = f"<!-- {marker} -->\n"
        before, found, after = page.partition(head)
        if not found:
            raise ValueError(f"{PAGE.name}: no table {marker}")
        _, end, after = after.partition("\n\n")
        page = before + head + "\n".join(_lines(table())) + end + after
    return page


def _lines(table: Table) -> list[str]:
    head, *rows = (f"| {' | '.join(row)} |" for row in (table.header, *table.texts))
    return [head, "|" + "---|" * len(table.columns), *rows]


@cache
def study(name: str) -> StudyFindings:
    """What the runs of a study of results/ say."""
    return study_findings(ROOT / "results" / name)


@cache
def runs(name: str) -> pd.DataFrame:
    """The runs of one of docs/protocol.md's studies, by its folder in results/."""
    return runs_of(ROOT / "results" / name)


@cache
def foretellers() -> tuple[Prediction, ...]:
    """Who predicted the protocol's camera sets."""
    found, left_out = predictions(None, ROOT / "results", [*paper.lists().values()], "protocol")
    assert not left_out, left_out
    return found


def peg_foretellers() -> tuple[Prediction, ...]:
    """Who predicted the same camera sets for the peg transfer: a model, and the needle's runs."""
    ranked = pd.read_csv(RECORDINGS / "claude_peg_transfer" / "rankings.csv")
    orders = [
        dict(zip(own["cameras"], -own["place"], strict=True)) for _, own in ranked.groupby("list")
    ]
    needle = scored(NEEDLE, means(runs("protocol")), paper.lists().values())
    return Prediction("claude", {frozenset(order): order for order in orders}), needle


def survived() -> pd.DataFrame:
    """What disturbances cost the protocol's runs."""
    return survival.survival(stress_of(PROTOCOL))


def _results() -> Table:
    """The fast protocol's camera sets, the best first, with what else was measured of them.

    That is the paper's protocol as far as it has been run, and the paper's own returns. Success is
    given seed by seed: two seeds of one set can be far apart.
    """
    longer, theirs = {one.cameras: one for one in study("table2").ranked}, paper.measured()
    rows = []
    for one in study("fast").ranked:
        end = longer.get(one.cameras)
        own = [one.middle(measure) for measure in (RETURN, TRAINING, CHEAT)]
        later = [end and end.middle(measure) for measure in (SUCCESS, RETURN, TRAINING)]
        success = (one.middle(SUCCESS), one.values(SUCCESS))
        rows.append((one.cameras, *success, *own, *later, theirs.get(one.cameras)))
    columns = (
        Column("cameras"), Column.share("threaded"), Column("by seed", form=".0f", scale=100.0),
        Column("return", form=".2f"), Column("over training", form=".2f"), Column.share("cheat"),
        Column.share("1.5 M: threaded"), Column("1.5 M: return", form=".2f"),
        Column("1.5 M: over training", form=".2f"), Column("the paper's return", form=".2f"),
    )  # fmt: skip
    return Table("results", "", columns, tuple(rows))


def _claims() -> Table:
    found = [claims(study(name), one) for name in _PROTOCOLS.values() for one in _OVER_TRAINING]
    rows = tuple(
        (claim.text, "{:.2f} / {:.2f}".format(*claim.published), *(own.get(claim) for own in found))
        for claim in found[0]
    )
    columns = (
        Column(f"{steps}: {said} (95 %)", form="+.2f")
        for steps in _PROTOCOLS
        for said in _OVER_TRAINING.values()
    )
    said = (Column("the paper says"), Column("its returns"))
    return Table("claims", "", (*said, *columns), rows)


def _foretold() -> Table:
    """Each prediction against the earlier studies: tau-b, p beyond the rule, regret.

    The protocol's runs predict them, too.
    """
    found: dict[str, dict[str, Cell]] = {}
    imitated = scored(IMITATED, means(runs("protocol")), paper.lists().values())
    for column, (name, truth) in _MEASURED.items():
        measured = study(name).truths[truth]
        foretold = [*study(name).predictions_of(truth), imitated]
        for who, lists in predicted(foretold).items():
            tau, p, lost = held(who, lists, measured)
            cell: list[Cell] = [] if tau is None else [tau]
            cell += [] if p is None else [f"p {Column('p', form='p').text(p)}"]
            cell += [f"loses {lost:.2f}"]
            found.setdefault(who, {})[column] = cell
    ordered = [who for who in found if who not in (RULE, BLIND)] + [RULE, BLIND]
    rows = tuple((who, *(found[who].get(column) for column in _MEASURED)) for who in ordered)
    columns = (Column(name, form=".2f") for name in _MEASURED)
    return Table("foretold", "", (Column("prediction"), *columns), rows)


def _rewards() -> Table:
    """Each reward's runs, in the order of ``_REWARDED``, by what compares across rewards."""
    measures = (SUCCESS, BEST, HUMAN_POINTS, CHEAT, SUCCESS_OVER_TRAINING)
    rows = []
    for reward, results in study("rewards").by_reward.items():
        by_cameras = {one.cameras: one for one in results}
        own = [by_cameras[cameras] for cameras in _REWARDED]
        numbers = ([one.middle(measure) for one in own] for measure in measures)
        rows.append((reward_label(reward), *numbers, [soon(one) for one in own]))
    columns = (Column("reward"), *map(Column.of, measures), TO_SOON)
    return Table("rewards", "", columns, tuple(rows))


TABLES: Mapping[str, Callable[[], Table]] = {
    "protocol": lambda: sets_table(runs("protocol")),
    "protocol_traits": lambda: traits_table(runs("protocol")),
    "protocol_changes": lambda: changes_table(runs("protocol")),
    "protocol_foretold": lambda: foretold_table(foretellers(), means(runs("protocol"))),
    "pegs": lambda: sets_table(runs(PEGS), "placed"),
    "pegs_traits": lambda: traits_table(runs(PEGS)),
    "pegs_changes": lambda: changes_table(runs(PEGS)),
    "pegs_foretold": lambda: foretold_table(peg_foretellers(), means(runs(PEGS))),
    "places": lambda: placements.places_table(runs("placements")),
    "placements": lambda: placements.foretold_table(placements.single_scores(), runs("placements")),
    "pairs": lambda: placements.places_table(runs(PAIRS)),
    "pairs_foretold": lambda: placements.foretold_table(
        placements.pair_scores(runs("placements")), runs(PAIRS)
    ),
    "survival": lambda: survival.sets_table(runs("protocol"), survived()),
    "survival_axes": lambda: survival.axes_table(stress_of(PROTOCOL)),
    "survival_foretold": lambda: survival.foretold_table(runs("protocol"), stress_of(PROTOCOL)),
    "writers": lambda: writers_table(runs("protocol_rewards")),
    "results": _results,
    "claims": _claims,
    "foretold": _foretold,
    "rewards": _rewards,
}
"""The page's tables, by the comments above them."""

FIGURES: Mapping[str, Callable[[], Figure]] = {
    "which_cameras": lambda: sets_figure(runs("protocol")),
    "foretold": lambda: foretold_figure(foretellers(), means(runs("protocol"))),
    "where_cameras": lambda: placements.places_figure(runs("placements"), runs(PAIRS)),
    "survival": lambda: survival.survival_figure(survived()),
}
"""PNG files of docs/."""


def main() -> None:
    """Refill the page, draw figures."""
    PAGE.write_text(refilled(PAGE.read_text()))
    for name, figure in FIGURES.items():
        with styled():
            _, vector = save(figure(), ROOT / "docs" / name)
        vector.unlink()
    print(f"refilled {PAGE.name}")


if __name__ == "__main__":
    main()
