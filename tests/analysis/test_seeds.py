"""How much is the cameras', and how much the seeds', held against scipy's own tests."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import f_oneway
from study_files import BUFFER, write_run

from analysis.seeds import BEST, LEVEL, WORSE, apart, luck
from needlehoop.study.render.table import Estimated
from needlehoop.study.stats.findings import paper_findings, study_findings
from needlehoop.study.stats.run import TRAINING
from needlehoop.study.stats.statistics import Interval

NAMES = ("dep_front+seg_side", "dep_front+dep_side", "rgb_front+rgb_side", "dep_default")
SHORT = {"updates": 3, "steps": 3 * BUFFER}


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


def test_luck_is_tested_as_scipy_does(tmp_path):
    groups = [[8.0, 7.0, 7.5], [5.0, 6.5], [6.0, 7.0, 8.0, 5.0]]
    by_return, by_success = luck(study_of(tmp_path / "main", groups)).records()
    assert by_return["p"] == pytest.approx(f_oneway(*groups).pvalue)
    # A tenth of the return: the same shares of another unit.
    assert by_success["of"] == "success, %"
    for column in ("the cameras' share, %", "95 %", "p", "seeds needed"):
        if column == "95 %":
            ends = [(row[column].low, row[column].high) for row in (by_success, by_return)]
            assert ends[0] == pytest.approx(ends[1])
        else:
            assert by_success[column] == pytest.approx(by_return[column])
    assert by_return["sets, seeds"] == "3, 2 to 4"
    # Means of k seeds: k s / (k s + 1 - s) of their variance is the cameras'.
    share, seeds = by_return["the cameras' share, %"], by_return["seeds needed"]
    reliable = [k * share / (k * share + 1 - share) for k in (seeds - 1, seeds)]
    assert reliable[0] < 0.8 <= reliable[1]


def test_the_share_is_that_of_the_variance(tmp_path, monkeypatch):
    """Drawn with deviations of 1.0 between sets and 0.5 between seeds: 80 % of it."""
    random = np.random.default_rng(0)
    names = [f"{r}_{v}" for r in ("rgb", "dep", "seg") for v in range(20)]
    groups = [random.normal(5.0, 1.0) + random.normal(0.0, 0.5, 3) for _ in names]
    by_return, _ = luck(study_of(tmp_path / "main", groups, names)).records()
    assert float(by_return["sd between sets"]) == pytest.approx(1.0, abs=0.2)
    assert float(by_return["sd between seeds of a set"]) == pytest.approx(0.5, abs=0.1)
    low, high = by_return["95 %"].low, by_return["95 %"].high
    assert low < 0.8 < high
    assert high - low < 0.3
    assert by_return["seeds needed"] in (1, 2)


def test_seeds_alone_are_no_cameras(tmp_path):
    groups = [[4.0, 8.0], [8.0, 4.0], [4.1, 7.9]]
    by_return, _ = luck(study_of(tmp_path / "main", groups)).records()
    assert by_return["the cameras' share, %"] == 0.0
    assert by_return["sd between sets"] == "0.00"
    assert by_return["seeds needed"] == "no number"


def test_differences_from_the_best_are_tukeys(tmp_path):
    groups = [[8.0, 8.2, 8.4], [7.9, 8.3, 8.1], [5.0, 5.4, 5.3], [8.1, 7.9, 6.0]]
    free = 8
    deviation = np.sqrt(sum(np.var(own) * len(own) for own in groups) / free)
    # The studentised range's upper 5 % of 4 means and 8 degrees of freedom, from a printed table.
    half = 4.529 * deviation / np.sqrt(3)
    for column, over in (("return", ""), ("training", "over training: ")):
        table = apart(study_of(tmp_path / column, groups, column=column))
        rows = {row["cameras"]: row for row in table.records()}
        said = [rows[name][f"{over}which is"] for name in NAMES]
        assert said == [BEST, LEVEL, WORSE, LEVEL]
        for name, own in zip(NAMES[1:], groups[1:], strict=True):
            cell = rows[name][f"{over}from the best, 95 %"]
            assert isinstance(cell, Estimated)
            assert isinstance(cell.interval, Interval)
            difference = np.mean(own) - np.mean(groups[0])
            assert cell.value == pytest.approx(difference)
            ends = (cell.interval.low, cell.interval.high)
            assert ends == pytest.approx((difference - half, difference + half), abs=2e-3)


def test_returns_over_training_are_those_of_all_buffers(tmp_path):
    groups = [[4.0, 4.5], [2.0, 2.25]]
    found = study_of(tmp_path / "main", groups, column="training")
    values = found.by_set(TRAINING)
    assert [values[name] for name in NAMES[:2]] == groups
    (of_training,) = [row for row in luck(found).records() if row["of"] == TRAINING.name]
    assert of_training["p"] == pytest.approx(f_oneway(*groups).pvalue)


def test_training_that_is_not_over_has_no_return_over_it(tmp_path):
    study = tmp_path / "main"
    write_run(study, NAMES[0], updates=20)
    assert study_findings(study).by_set(TRAINING) == {}


def test_nothing_is_said_without_repeats_that_differ(tmp_path):
    cases = ([[8.0], [5.0]], [[8.0, 7.0], [5.0]], [[8.0, 8.0], [5.0, 5.0]])
    for number, groups in enumerate(cases):
        found = study_of(tmp_path / str(number), groups)
        assert luck(found).rows == apart(found).rows == ()
    assert luck(paper_findings(tmp_path)).rows == ()
