"""How much is the cameras', and how much the seeds', held against scipy's own tests."""

import csv
import json
import re

import numpy as np
import pytest
from scipy.stats import f_oneway, tukey_hsd
from study_files import BUFFER, write_run

from needlehoop.study.data.combinations import label
from needlehoop.study.data.findings import paper_findings, study_findings
from needlehoop.study.stats.luck import BEST, LEVEL, WORSE, apart, luck, noise
from needlehoop.study.stats.measures import RETURN, TRAINING, by_seed

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


def rows_of(table) -> list[dict[str, str]]:
    return [dict(zip(table.header, row, strict=True)) for row in table.rows]


def test_luck_is_tested_as_scipy_does(tmp_path):
    groups = [[8.0, 7.0, 7.5], [5.0, 6.5], [6.0, 7.0, 8.0, 5.0]]
    by_return, by_success = rows_of(luck(study_of(tmp_path / "main", groups)))
    assert float(by_return["p"]) == pytest.approx(f_oneway(*groups).pvalue, abs=0.005)
    # A tenth of the return: the same shares of another unit.
    assert by_success["of"] == "success, %"
    for column in ("the cameras' share, %", "95 %", "p", "seeds needed"):
        assert by_success[column] == by_return[column]
    assert by_return["sets, seeds"] == "3, 2 to 4"
    # Means of k seeds: k s / (k s + 1 - s) of their variance is the cameras'.
    share, seeds = int(by_return["the cameras' share, %"]) / 100, int(by_return["seeds needed"])
    reliable = [k * share / (k * share + 1 - share) for k in (seeds - 1, seeds)]
    assert reliable[0] < 0.8 <= reliable[1]


def test_the_share_is_that_of_the_variance(tmp_path, monkeypatch):
    """Drawn with deviations of 1.0 between sets and 0.5 between seeds: 80 % of it."""
    random = np.random.default_rng(0)
    names = [f"{r}_{v}" for r in ("rgb", "dep", "seg") for v in range(20)]
    groups = [random.normal(5.0, 1.0) + random.normal(0.0, 0.5, 3) for _ in names]
    by_return, _ = rows_of(luck(study_of(tmp_path / "main", groups, names)))
    assert float(by_return["sd between sets"]) == pytest.approx(1.0, abs=0.2)
    assert float(by_return["sd between seeds of a set"]) == pytest.approx(0.5, abs=0.1)
    low, high = map(float, by_return["95 %"].split(" to "))
    assert low < 80 < high
    assert high - low < 30
    assert by_return["seeds needed"] in ("1", "2")


def test_seeds_alone_are_no_cameras(tmp_path):
    groups = [[4.0, 8.0], [8.0, 4.0], [4.1, 7.9]]
    by_return, _ = rows_of(luck(study_of(tmp_path / "main", groups)))
    assert by_return["the cameras' share, %"] == "0"
    assert by_return["sd between sets"] == "0.00"
    assert by_return["seeds needed"] == "no number"


@pytest.mark.parametrize("column", ["return", "training"])
def test_differences_from_the_best_are_tukeys(tmp_path, column):
    groups = [[8.0, 8.2, 8.4], [7.9, 8.3, 8.1], [5.0, 5.4, 5.3], [8.1, 7.9, 6.0]]
    found = study_of(tmp_path / "main", groups, column=column)
    rows = rows_of(apart(found))
    expected = tukey_hsd(*groups)
    limits = expected.confidence_interval()
    over = "" if column == "return" else "over training: "
    by_cameras = {row["cameras"]: row for row in rows}
    assert len(by_cameras) == 4
    assert [by_cameras[label(name)][f"{over}which is"] for name in NAMES] == [
        BEST,
        LEVEL,
        WORSE,
        LEVEL,
    ]
    for i, name in enumerate(NAMES[1:], start=1):
        cell = by_cameras[label(name)][f"{over}from the best, 95 %"]
        difference, low, high = map(float, re.findall(r"[-+.\d]+", cell))
        assert difference == pytest.approx(expected.statistic[i, 0], abs=0.006)
        assert low == pytest.approx(limits.low[i, 0], abs=0.006)
        assert high == pytest.approx(limits.high[i, 0], abs=0.006)


def test_returns_over_training_are_those_of_all_buffers(tmp_path):
    groups = [[4.0, 4.5], [2.0, 2.25]]
    found = study_of(tmp_path / "main", groups, column="training")
    values = by_seed(found, TRAINING)
    assert [[*values[name].values()] for name in NAMES[:2]] == groups
    (of_training,) = [row for row in rows_of(luck(found)) if row["of"] == TRAINING.name]
    assert float(of_training["p"]) == pytest.approx(f_oneway(*groups).pvalue, abs=0.005)


def test_training_that_is_not_over_has_no_return_over_it(tmp_path):
    study = tmp_path / "main"
    write_run(study, NAMES[0], updates=20)
    assert by_seed(study_findings(study), TRAINING) == {}


@pytest.mark.parametrize("groups", [[[8.0], [5.0]], [[8.0, 7.0], [5.0]], [[8.0, 8.0], [5.0, 5.0]]])
def test_nothing_is_said_without_repeats_that_differ(tmp_path, groups):
    found = study_of(tmp_path / "main", groups)
    assert luck(found).rows == ()
    assert apart(found).rows == ()


def test_one_repeated_set_is_enough_for_its_noise(tmp_path):
    found = noise(study_of(tmp_path / "main", [[8.0, 7.0, 6.0], [5.0]]), RETURN)
    assert found is not None
    assert (found.deviation, found.free) == (pytest.approx(1.0), 2)


def test_the_papers_single_runs_say_nothing_of_luck(tmp_path):
    assert noise(paper_findings(tmp_path), RETURN) is None
    assert luck(paper_findings(tmp_path)).rows == ()
