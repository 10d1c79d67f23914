"""What docs/findings.md says is what the runs in results/ gave."""

import csv
import io
import json
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
from scipy.stats import kendalltau

from needlehoop.study import paper
from needlehoop.study.claims import CLAIMS
from needlehoop.study.combinations import label
from needlehoop.study.findings import study_findings
from needlehoop.study.reliability import OTHER_SEEDS
from needlehoop.study.table import Table
from needlehoop.study.tables import all_tables

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "findings.md").read_text()
AGREEMENT = "results/fast agreement"


def cells_of(marker: str) -> list[list[str]]:
    """The page's table under a comment that names its source, its head first."""
    lines = PAGE.partition(f"<!-- {marker} -->\n")[2].splitlines()
    rows = lines[: lines.index("")]
    head, _, *rest = [[cell.strip() for cell in line.strip("|").split("|")] for line in rows]
    return [head, *rest]


def rows_of(marker: str) -> list[dict[str, str]]:
    """The same as rows by the head's names."""
    head, *rows = cells_of(marker)
    return [dict(zip(head, row, strict=True)) for row in rows]


@cache
def tables(study: str) -> dict[str, Table]:
    return {one.name: one for one in all_tables(study_findings(ROOT / "results" / study))}


def table(study: str, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(tables(study)[name].csv())))


def test_claims_on_the_page_are_judged_by_the_runs():
    difference = "difference, 95 %"
    kept = ("the paper says", "its returns", difference, f"return over training: {difference}")
    expected = [{name: row[name] for name in kept} for row in table("fast", "claims")]
    assert len(expected) == len(CLAIMS)
    assert rows_of("results/fast claims") == expected


def test_a_refilled_page_is_the_page():
    spec = spec_from_file_location("refill", ROOT / "docs" / "refill.py")
    assert spec is not None
    assert spec.loader is not None
    refill = module_from_spec(spec)
    spec.loader.exec_module(refill)
    assert refill.refilled(PAGE) == PAGE
    with pytest.raises(ValueError, match="no table results/fast effects"):
        refill.refilled(PAGE.replace("fast effects", "fast nothing"))


@pytest.mark.parametrize("study", ["fast", "imitation", "table2"])
@pytest.mark.parametrize(
    "name", ["results", "phases", "effects", "claims", "cost", "luck", "apart"]
)
def test_tables_in_results_are_those_of_its_runs(study, name):
    path = ROOT / "results" / study / "tables" / f"{name}.csv"
    assert path.exists() == (name in tables(study))
    # Of one seed each, some tables have no rows.
    assert path.exists() or study == "table2"
    if path.exists():
        with path.open(newline="") as file:
            assert list(csv.DictReader(file)) == table(study, name)


def test_the_ranking_on_the_page_is_that_of_the_runs():
    longer = {row["cameras"]: row for row in table("table2", "results")}
    theirs = {label(cameras): f"{value:.2f}" for cameras, value in paper.measured().items()}
    imitated = {row["cameras"]: row["success, %"] for row in table("imitation", "results")}
    seeds: dict[str, list[str]] = {}
    for path in sorted((ROOT / "results" / "fast").glob("*/*/*/evaluation.json")):
        share = json.loads(path.read_text())["success"]
        seeds.setdefault(label(path.parts[-4]), []).append(f"{100 * share:.0f}")
    expected = [
        {
            "cameras": row["cameras"],
            "threaded, %": row["success, %"],
            "by seed": ", ".join(seeds[row["cameras"]]),
            "return": row["return"],
            "over training": row["return over training"],
            "cheat, %": row["cheat, %"],
            "imitated, %": imitated[row["cameras"]],
            "1.5 M: threaded, %": longer.get(row["cameras"], {}).get("success, %", ""),
            "1.5 M: return": longer.get(row["cameras"], {}).get("return", ""),
            "the paper's return": theirs.get(row["cameras"], ""),
        }
        for row in table("fast", "results")
    ]
    assert set(longer) <= {row["cameras"] for row in expected}
    assert rows_of("results") == expected


def test_luck_on_the_page_is_that_of_the_runs():
    fast, imitation = (
        {row["of"]: row for row in table(study, "luck")} for study in ("fast", "imitation")
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


def test_effects_on_the_page_are_those_of_the_runs():
    assert rows_of("results/fast effects") == table("fast", "effects")


def test_how_far_rankings_predict_is_what_the_tables_say():
    minutes = {
        row["prediction"]: row["core-minutes"]
        for row in table("fast", "cost")
        if row["against"] == "measured"
    }
    ends = {"measured": "", "return over training": "over training: "}
    others = {f"{OTHER_SEEDS}, return over training": "over training: ", OTHER_SEEDS: ""}
    expected: dict[str, list[str]] = {}
    for before in ends.values():
        for what, members, *numbers in tables("fast")["agreement"].rows:
            who, _, against = what.partition(" against ")
            if members == "all lists" and (ends | others).get(against) == before:
                tau, tau_range, p, _, _, _, _, regret, regret_range = numbers
                cells = [f"{tau} ({tau_range})".replace(" ()", ""), p]
                cells.append(f"{regret} ({regret_range})".replace(" ()", ""))
                expected.setdefault(who, []).extend(cells)
    head, *shown = cells_of(AGREEMENT)
    assert head[1:7] == ["tau-b", "p", "regret", "over training: tau-b", "p", "regret"]
    assert [row[:7] + row[8:] for row in shown] == [
        [who, *cells, minutes.get(who, "")] for who, cells in expected.items()
    ]


def test_the_fast_protocol_foretells_the_papers_as_the_page_says():
    over_training = [
        {row["cameras"]: float(row["return over training"]) for row in table(study, "results")}
        for study in ("fast", "table2")
    ]
    fast, longer = over_training
    tau, p = kendalltau([fast[cameras] for cameras in longer], [*longer.values()])
    section = PAGE.partition("## The paper's protocol")[2].partition("\n## ")[0]
    assert f"τ-b {tau:.2f} over the {len(longer)} sets, p = {p:.2f}" in " ".join(section.split())


def test_the_last_seed_alone_is_foretold_as_the_page_says():
    over_training = {}
    for path in (ROOT / "results" / "fast").glob("*/vlm_text/seed2/metrics.csv"):
        with path.open(newline="") as file:
            returns = [float(row["return"]) for row in csv.DictReader(file) if row["return"]]
        over_training[path.parts[-4]] = sum(returns) / len(returns)
    predictions = study_findings(ROOT / "results" / "fast").predictions
    column = {row["prediction"]: row["seed 2 alone: tau-b"] for row in rows_of(AGREEMENT)}
    assert len(predictions) == 4
    for one in predictions:
        taus = [
            kendalltau(*zip(*[(own[name], over_training[name]) for name in own], strict=True))
            for own in one.lists.values()
        ]
        mean = sum(tau.statistic for tau in taus) / len(taus)
        assert float(column[one.who]) == pytest.approx(mean, abs=0.0051)
    assert column["one seed"] == ""
