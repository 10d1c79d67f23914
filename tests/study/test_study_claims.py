"""What the paper says of cameras, held against a study."""

import json

import pytest
from study_files import PAIRS, write_run, write_study

from needlehoop.study.data import paper
from needlehoop.study.data.findings import paper_findings, study_findings
from needlehoop.study.stats.claims import CLAIMS, claims

DEPTH_IN_FRONT = "depth is better in front than at the side"


def rows_of(study) -> dict[str, dict[str, str]]:
    table = claims(study_findings(study))
    return {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}


def end_at(study, cameras, values):
    """Runs of a set that end at these returns, one for each seed."""
    for seed, value in enumerate(values):
        run = write_run(study, cameras, seed=seed)
        path = run / "evaluation.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"return": value}))


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.text)
def test_the_papers_own_numbers_bear_its_claims_out(claim):
    published = paper.measured()
    better, worse = ([published[name] for name in side] for side in (claim.better, claim.worse))
    assert sum(better) / len(better) > sum(worse) / len(worse)
    assert not set(claim.better) & set(claim.worse)


def test_a_study_like_the_paper_bears_them_out_too(tmp_path):
    found = rows_of(write_study(tmp_path / "main", PAIRS, seeds=3))
    assert list(found) == [claim.text for claim in CLAIMS]
    # Made-up returns scatter by 0.3 around the paper's, and some of its own differ by less.
    clear = [row for row in found.values() if abs(float(row["difference, 95 %"].split()[0])) > 1.0]
    assert len(clear) > 6
    assert {row["here"] for row in clear} == {"holds"}
    first = found[CLAIMS[0].text]
    assert first["cameras"] == "9 pairs against 3 single cameras"
    assert first["its returns"] == "5.77 / 1.55"


@pytest.mark.parametrize(
    ("front", "side", "said"),
    [
        ([8.0, 8.2, 8.1], [5.0, 5.5, 5.2], "holds"),
        ([5.0, 5.5, 5.2], [8.0, 8.2, 8.1], "reversed"),
        ([5.0, 8.5, 7.0], [8.0, 5.2, 7.1], "cannot be told"),
        ([5.0, 8.0], [8.0, 5.0], "cannot be told"),
        ([8.0, 8.1], [5.0, 5.2], "holds"),
        ([5.0], [8.0, 8.1, 8.2], "reversed; one seed, no interval"),
        ([8.0], [8.0], "no difference; one seed, no interval"),
    ],
)
def test_a_claim_is_judged_by_its_interval(tmp_path, front, side, said):
    end_at(tmp_path / "main", "dep_front+rgb_side", front)
    end_at(tmp_path / "main", "rgb_front+dep_side", side)
    # Others' sets have not been trained.
    (row,) = rows_of(tmp_path / "main").values()
    assert row["the paper says"] == DEPTH_IN_FRONT
    assert row["cameras"] == "DEP (F) + RGB (S) against RGB (F) + DEP (S)"
    assert row["here"] == said
    difference = sum(front) / len(front) - sum(side) / len(side)
    value, _, interval = row["difference, 95 %"].partition(" ")
    assert float(value) == pytest.approx(difference, abs=0.006)
    assert bool(interval) == ("interval" not in said)
    if interval:
        low, high = map(float, interval.strip("()").split(" to "))
        assert low <= difference <= high
        assert (low > 0, high < 0) == (said == "holds", said == "reversed")


def test_the_papers_own_page_has_no_such_table(tmp_path):
    assert claims(paper_findings(tmp_path)).rows == ()
