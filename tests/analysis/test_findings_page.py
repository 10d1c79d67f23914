"""What docs/findings.md and docs/evidence.md say is what the runs in results/ gave."""

import csv
import json
from functools import cache
from pathlib import Path

import pytest
from scipy.stats import kendalltau

from analysis import findings as analysis
from analysis.seeds import apart, luck
from needlehoop.study.render.table import Table
from needlehoop.study.report.tables import phases, results, rewards
from needlehoop.study.stats.run import TRAINING, steps_to_share

ROOT = Path(__file__).parents[2]
PAGES = {name: (ROOT / "docs" / name).read_text() for name in ("findings.md", "evidence.md")}
PAGE = "\n".join(PAGES.values())
TABLES = {"results": results, "phases": phases, "rewards": rewards, "apart": apart, "luck": luck}


def cells_of(marker: str) -> list[list[str]]:
    """The pages' table under a comment that names its source, its head first."""
    assert PAGE.count(f"<!-- {marker} -->\n") == 1
    lines = PAGE.partition(f"<!-- {marker} -->\n")[2].splitlines()
    rows = lines[: lines.index("")]
    head, _, *rest = [[cell.strip() for cell in line.strip("|").split("|")] for line in rows]
    return [head, *rest]


def rows_of(marker: str) -> list[dict[str, str]]:
    """The same as rows by the head's names."""
    head, *rows = cells_of(marker)
    return [dict(zip(head, row, strict=True)) for row in rows]


@cache
def table(study: str, name: str) -> Table:
    return TABLES[name](analysis.study(study))


def test_a_refilled_page_is_the_page():
    assert set(analysis.TABLES) == set(PAGES)
    for name, page in PAGES.items():
        assert analysis.refilled(name, page) == page
    with pytest.raises(ValueError, match=r"findings\.md: no table sets"):
        analysis.refilled("findings.md", PAGE.replace("<!-- sets", "<!-- nothing"))


def test_the_findings_tables_are_drawn_from_the_evidences():
    evidence = {row["cameras"]: row for row in rows_of("results")}
    sets = rows_of("sets")
    assert {row["cameras"] for row in sets} == set(evidence)
    assert all(row.items() <= evidence[row["cameras"]].items() for row in sets)
    soon = [float(row["over training"]) for row in sets]
    assert soon == sorted(soon, reverse=True)
    agreement = {row["prediction"]: row for row in rows_of("agreement")}
    regret = {row["chosen by"]: row for row in rows_of("regret")}
    foretold = rows_of("foretold")
    assert [row["prediction"] for row in foretold] == [*regret]
    for row in foretold:
        who = row.pop("prediction")
        lost = {name.removeprefix("regret: "): row.pop(name) for name in [*row] if "reg" in name}
        lost["core-minutes"] = row.pop("core-minutes")
        assert len(lost) == 4
        assert lost.items() <= regret[who].items()
        assert list(row) == ["0.5 M, over training", "1.5 M", "the paper's"]
        assert row.items() <= agreement.get(who, dict.fromkeys(row, "")).items()


def test_the_findings_fit_two_screens():
    # Of some fifty lines each, at 120 characters; a row of a table is one.
    assert PAGES["findings.md"].count("\n") <= 100


def test_success_by_seed_is_what_evaluations_say():
    shown = {row["cameras"]: row["by seed"] for row in rows_of("results")}
    seeds: dict[str, list[str]] = {}
    for path in sorted((ROOT / "results" / "fast").glob("*/*/*/evaluation.json")):
        share = json.loads(path.read_text())["success"]
        seeds.setdefault(path.parts[-4], []).append(f"{100 * share:.0f}")
    assert shown == {cameras: ", ".join(own) for cameras, own in seeds.items()}


def test_luck_on_the_page_is_that_of_the_runs():
    fast, imitation = (
        {row["of"]: row for row in table(study, "luck").texts_by_heading()}
        for study in ("fast", "imitation")
    )
    end, success, over_training = map(
        share_of, (fast["return"], fast["success, %"], fast["return over training"])
    )
    words = " ".join(PAGE.split())
    assert f"is {over_training} of returns over training, {end} of final returns" in words
    assert f"and {success} of success" in words
    assert f"Of imitation's successes it is {share_of(imitation['success, %'])}." in words
    seeds = [fast[of]["seeds needed"] for of in ("return over training", "return", "success, %")]
    assert "means of {}, {} and {} seeds".format(*seeds) in words


def share_of(row: dict[str, str]) -> str:
    share, interval = row["the cameras' share, %"], row["95 %"]
    return f"{share} % ({interval})"


def test_the_fast_protocol_foretells_the_papers_as_the_page_says():
    fast, longer = (analysis.study(study).middles(TRAINING) for study in ("fast", "table2"))
    tau, p = kendalltau([fast[cameras] for cameras in longer], [*longer.values()])
    assert f"τ-b {tau:.2f} over the {len(longer)} sets, p = {p:.2f}" in " ".join(PAGE.split())


def test_sentences_on_the_papers_protocol_have_the_tables_numbers():
    effects = {row["trait"]: row["1.5 M: over training (95 %)"] for row in rows_of("effects")}
    second_view = effects["front and side views, not the default"].replace("+", "")
    words = " ".join(PAGE.split())
    assert second_view.replace(" (", " points over training (") in words
    sooner = {row["trait"]: row["0.5 M: over training (95 %)"] for row in rows_of("effects")}
    view, depth, segmentation, two = (
        sooner[trait].replace("+", "")
        for trait in (
            "front and side views, not the default",
            "depth in a camera",
            "segmentation in a camera",
            "two cameras, not one",
        )
    )
    assert f"instead of the default {view}, segmentation in a camera {segmentation}" in words
    assert f"depth {depth}, two cameras instead of one nothing that shows, {two}." in words
    taus = {row["prediction"]: row["1.5 M"].partition(",")[0] for row in rows_of("agreement")}
    assert (
        "the probe by {probe}, `claude` by {claude}, the paper's model by {the paper's VLM}; our 51"
        " runs of 0.5 M steps by {fast protocol}, the paper's own returns by {the paper's measured}"
    ).format(**taus) in words
    *choices, blind = [float(row["1.5 M"]) for row in rows_of("regret") if row["1.5 M"]]
    assert f"{max(choices):.2f} points at most, a blind one {blind:.2f}" in words


def listed(cells: list[str]) -> str:
    """As a sentence has them."""
    return " and ".join([", ".join(cells[:-1]), cells[-1]])


REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")


def test_sentences_on_rewards_have_the_runs_numbers():
    of = {
        (row["cameras"], row["reward"]): row
        for row in table("rewards", "rewards").texts_by_heading()
        if row["cameras"] in REWARDED
    }
    words = " ".join(PAGE.split())

    def said(reward: str, column: str) -> list[str]:
        return [of[cameras, reward][column] for cameras in REWARDED]

    claudes = [row for (_, reward), row in of.items() if reward.startswith("claude")]
    assert {row["cheat, %"] for row in claudes} == {"0"}
    least, *others = sorted(int(row["success, %"]) for row in claudes)
    assert others == [100] * 5
    assert f"five of six agents thread in 100 of 100, one in {least}" in words
    points = sorted(row["human's points"] for row in claudes)
    assert f"for {points[0]} to {points[-1]} of the human reward's points" in words
    own = sorted(said("human", "human's points"))
    assert f"(its own agents: {own[0]} to {own[-1]})" in words
    soon = [
        listed(said(reward, "M steps to 90 %"))
        for reward in ("claude, text + image", "claude, text", "human")
    ]
    (more,) = (
        row["success over training, % (95 %)"]
        for row in rows_of("writers")
        if row["reward"] == "claude, text + image, against text alone"
    )
    more = more.removeprefix("+").replace(" (", " % more over training, ")
    said_of_image = "after {} M steps with it, {} M without ({more}, {} M with the human"
    assert said_of_image.format(*soon, more=more) in words
    ends = said("VLM, text", "success, %")
    assert f"in {listed(ends)} of 100 at the end" in words
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"as good as the human one, in {least} to 100 of 100" in readme
    assert f"and then unlearnt, to {listed(ends)} of 100" in readme
    for success, cheat in zip(ends, said("VLM, text", "cheat, %"), strict=True):
        assert int(success) + int(cheat) == 100
    images = said("VLM, text + image", "success, %")
    assert f"hovers before the hoop ({images[0]})" in words
    assert f"or cheat ({listed(images[1:])})" in words


def test_the_papers_text_reward_is_unlearnt_as_the_page_says():
    at_best, last = [], []
    for path in (ROOT / "results" / "rewards").glob("*/vlm_text/seed0/evaluations.csv"):
        with path.open(newline="") as file:
            rows = {int(row["step"]): row for row in csv.DictReader(file)}
        at_best.append(rows[1_024_000])
        last.append(rows[max(rows)])
    assert {(row["episodes"], float(row["success"])) for row in at_best} == {("20", 1.0)}
    hovering = max(last, key=lambda row: float(row["cheat"]))
    threading = at_best[last.index(hovering)]
    said = "at the hoop's very centre pays {:.1f}, to go on through it {:.1f}"
    returns = [float(row["return"]) for row in (hovering, threading)]
    words = " ".join(PAGE.split())
    assert said.format(*returns) in words
    assert "in 20 of 20 at 1.0 M steps" in words


def test_how_soon_half_thread_is_as_the_page_says():
    steps: dict[bool, list[float]] = {True: [], False: []}
    for result in analysis.study("table2").ranked:
        for run in result.runs:
            half = steps_to_share(run, "success", 0.5)
            assert half is not None
            steps["side" in result.cameras].append(half / 1e6)
    pairs, one_view = (f"{min(own):.2f} to {max(own):.2f} M steps" for own in steps.values())
    words = " ".join(PAGE.split())
    assert f"Half of their training episodes thread at {pairs}" in words
    assert f"half at {one_view}" in words


def test_the_last_seed_alone_is_foretold_as_the_page_says():
    over_training = {}
    for path in (ROOT / "results" / "fast").glob("*/vlm_text/seed2/metrics.csv"):
        with path.open(newline="") as file:
            returns = [float(row["return"]) for row in csv.DictReader(file) if row["return"]]
        over_training[path.parts[-4]] = sum(returns) / len(returns)
    predictions = [one for one in analysis.study("fast").predictions if len(one.lists) == 3]
    assert len(predictions) == 6
    means = []
    for one in predictions:
        taus = [
            kendalltau(*zip(*[(own[name], over_training[name]) for name in own], strict=True))
            for own in one.lists.values()
        ]
        means.append(sum(tau.statistic for tau in taus) / len(taus))
    said = f"with that seed alone they agree by {min(means):.2f} to {max(means):.2f}"
    assert said in " ".join(PAGE.split())
