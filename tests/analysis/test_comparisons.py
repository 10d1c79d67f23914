"""The paper's comparisons, held against values worked out in other ways."""

import csv
import json

import numpy as np
import pytest
from study_files import BUFFER, PAIRS, write_run, write_study

from analysis.comparisons import CLAIMS, claims
from needlehoop.study.render.table import Estimated
from needlehoop.study.stats.findings import paper_findings, study_findings
from needlehoop.study.stats.run import RETURN, TRAINING

NAMES = ("dep_front+seg_side", "dep_front+dep_side", "rgb_front+rgb_side", "dep_default")
SHORT = {"updates": 3, "steps": 3 * BUFFER}


def rewrite(run, **numbers):
    path = run / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | numbers))


def ends_of(found: Estimated | None) -> tuple[float, float]:
    assert found is not None
    assert found.interval is not None
    return found.interval.low, found.interval.high


def test_the_papers_own_numbers_bear_its_claims_out():
    for claim in CLAIMS:
        better, worse = claim.published
        assert better > worse
        assert not set(claim.better) & set(claim.worse)


def test_a_study_like_the_paper_bears_them_out_too(tmp_path):
    found = claims(study_findings(write_study(tmp_path / "main", PAIRS, seeds=3)), RETURN)
    assert [*found] == [*CLAIMS]
    # Made-up returns scatter by 0.3 around the paper's, and some of its own differ by less.
    clear = [one for one in found.values() if abs(one.value) > 1.0]
    assert len(clear) > 6
    assert all(ends_of(one)[0] > 0 for one in clear)
    assert claims(paper_findings(tmp_path), RETURN) == {}


def test_a_claim_is_judged_by_its_interval(tmp_path):
    for number, (front, side, low, high) in enumerate(
        (
            ([8.0, 8.2, 8.1], [5.0, 5.5, 5.2], True, True),
            ([5.0, 5.5, 5.2], [8.0, 8.2, 8.1], False, False),
            ([5.0, 8.5, 7.0], [8.0, 5.2, 7.1], False, True),
            ([8.0, 8.1], [5.0, 5.2], True, True),
            ([5.0], [8.0, 8.1, 8.2], None, None),
        )
    ):
        study = tmp_path / str(number)
        for cameras, values in (("dep_front+rgb_side", front), ("rgb_front+dep_side", side)):
            for seed, value in enumerate(values):
                rewrite(
                    write_run(study, cameras, seed=seed, updates=2, steps=20_480),
                    **{"return": value},
                )
        # Others' sets have not been trained.
        ((claim, found),) = claims(study_findings(study), RETURN).items()
        assert claim.text == "depth is better in front than at the side"
        assert found.value == pytest.approx(np.mean(front) - np.mean(side))
        if low is None:
            assert found.interval is None
            continue
        assert tuple(end > 0 for end in ends_of(found)) == (low, high)
        # Student's, of the two sets' pooled scatter.
        free = len(front) + len(side) - 2
        squares = sum(float(np.var(own)) * len(own) for own in (front, side))
        error = np.sqrt(squares / free * (1 / len(front) + 1 / len(side)))
        quantile = {4: 2.7764, 2: 4.3027}[free]
        assert ends_of(found)[1] == pytest.approx(found.value + quantile * error, abs=1e-3)


def study_of(folder, groups, names=NAMES, column="return"):
    """A study of sets with these returns, in the end or in training; a tenth of it in success."""
    for name, values in zip(names, groups, strict=False):
        for seed, value in enumerate(values):
            run = write_run(folder, name, seed=seed, **SHORT)
            if column == "training":
                over_training(run / "metrics.csv", float(value))
                continue
            path = run / "evaluation.json"
            outcome = {"return": float(value), "success": float(value) / 10}
            path.write_text(json.dumps(json.loads(path.read_text()) | outcome))
    return study_findings(folder)


def over_training(path, mean):
    """Write returns with this mean into a run's metrics, whose first buffer ends no episode."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["return"] == ""
    for row, away in zip(rows[1:], (-0.5, 0.5), strict=True):
        row["return"] = str(mean + away)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def test_returns_over_training_are_those_of_all_buffers(tmp_path):
    groups = [[4.0, 4.5], [2.0, 2.25]]
    found = study_of(tmp_path / "main", groups, column="training")
    values = found.by_set(TRAINING)
    assert [values[name] for name in NAMES[:2]] == groups
    for number in range(len(groups)):
        write_run(tmp_path / "short", NAMES[number], updates=20)
    assert study_findings(tmp_path / "short").by_set(TRAINING) == {}
