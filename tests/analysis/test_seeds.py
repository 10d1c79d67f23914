"""How much is the cameras', and how much the seeds', held against scipy's own tests."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import f_oneway
from study_files import BUFFER, PAIRS, write_run, write_study

from analysis.seeds import BEST, LEVEL, WORSE, apart, by_seed, luck, repeat, spread
from needlehoop.study.render.table import Estimated
from needlehoop.study.stats.agreement import pooled
from needlehoop.study.stats.findings import paper_findings, study_findings
from needlehoop.study.stats.run import RETURN, TRAINING
from needlehoop.study.stats.statistics import Interval, iqm, resample

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
    values = by_seed(found, TRAINING)
    assert [[*values[name].values()] for name in NAMES[:2]] == groups
    (of_training,) = [row for row in luck(found).records() if row["of"] == TRAINING.name]
    assert of_training["p"] == pytest.approx(f_oneway(*groups).pvalue)


def test_training_that_is_not_over_has_no_return_over_it(tmp_path):
    study = tmp_path / "main"
    write_run(study, NAMES[0], updates=20)
    assert by_seed(study_findings(study), TRAINING) == {}


def test_nothing_is_said_without_repeats_that_differ(tmp_path):
    cases = ([[8.0], [5.0]], [[8.0, 7.0], [5.0]], [[8.0, 8.0], [5.0, 5.0]])
    for number, groups in enumerate(cases):
        found = study_of(tmp_path / str(number), groups)
        assert luck(found).rows == apart(found).rows == ()
    assert luck(paper_findings(tmp_path)).rows == ()


def ends(found: Interval | None) -> tuple[float, float]:
    assert found is not None
    return found.low, found.high


def lists_of_two() -> list[tuple[dict[str, float], dict[str, list[float]]]]:
    """Two lists that share the set ``b``, with four seeds of each set."""
    runs = {
        "a": [1.0, 1.2, 0.9, 1.1],
        "b": [2.0, 2.5, 0.5, 2.2],
        "c": [3.0, 1.0, 3.3, 2.9],
        "d": [0.1, 0.2, 0.3, 4.0],
    }
    first = {"a": 1.0, "b": 2.0, "c": 3.0}
    second = {"b": 2.0, "d": 1.0}
    return [(one, {name: runs[name] for name in one}) for one in (first, second)]


def spread_of(sides, seed: int = 0):
    runs = {name: own for _, side in sides for name, own in side.items()}
    return spread([predicted for predicted, _ in sides], runs, seed)


def test_an_interval_is_that_of_pooled_agreement_over_drawn_seeds():
    sides = lists_of_two()
    found = spread_of(sides)
    assert found is not None
    # The very draws, one by one.
    generator = np.random.default_rng(0)
    runs = {name: own for _, side in sides for name, own in side.items()}
    drawn = {name: iqm(resample(np.array(runs[name]), generator), axis=1) for name in sorted(runs)}
    taus, regrets = [], []
    for number in range(len(drawn["a"])):
        values = [(p, {name: drawn[name][number] for name in side}) for p, side in sides]
        tau, regret = pooled_of(values)
        taus.append(tau)
        regrets.append(regret)
    assert ends(found.tau) == pytest.approx(np.nanpercentile(taus, (2.5, 97.5)))
    assert ends(found.regret) == pytest.approx(np.percentile(regrets, (2.5, 97.5)))
    other = spread_of(sides, seed=1)
    assert other is not None
    assert other != found
    assert ends(other.regret) == pytest.approx(ends(found.regret), abs=0.15)


def pooled_of(sides) -> tuple[float, float]:
    """Mean tau-b and regret by counting pairs; no tau-b of a list that is all on one level."""
    taus, regrets = [], []
    for predicted, values in sides:
        names = sorted(predicted)
        pairs = [(one, two) for i, one in enumerate(names) for two in names[i + 1 :]]
        signs = [
            np.sign(predicted[one] - predicted[two]) * np.sign(values[one] - values[two])
            for one, two in pairs
        ]
        apart = sum(values[one] != values[two] for one, two in pairs)
        if apart:
            taus.append(sum(signs) / np.sqrt(len(pairs) * apart))
        best = max(names, key=lambda name: predicted[name])
        regrets.append(max(values.values()) - values[best])
    return float(np.mean(taus or [np.nan])), float(np.mean(regrets))


def test_seeds_that_agree_leave_nothing_open():
    same = [(p, {name: [p[name]] * 3 for name in p}) for p, _ in lists_of_two()]
    found = spread_of(same)
    assert found is not None
    assert ends(found.tau) == pytest.approx((1.0, 1.0))
    assert ends(found.regret) == (0.0, 0.0)
    together = pooled([(p, {name: own[0] for name, own in side.items()}) for p, side in same])
    assert (together.tau, together.regret) == (pytest.approx(1.0), 0.0)


def test_what_puts_all_on_one_level_has_regrets_alone():
    level = [(dict.fromkeys(p, 1.0), side) for p, side in lists_of_two()]
    found = spread_of(level)
    assert found is not None
    assert found.tau is None
    assert found.regret.high > found.regret.low > 0.0


def test_too_few_seeds_have_no_interval():
    sides = lists_of_two()
    sides[1][1]["d"] = [1.0, 2.0]
    assert spread_of(sides) is None
    assert spread_of([]) is None


def test_each_seed_is_held_against_the_others(tmp_path):
    names = [cameras for cameras, _ in PAIRS]
    write_study(tmp_path / "main", PAIRS, seeds=2)
    # A third seed of some sets alone ranks no list.
    write_run(tmp_path / "main", names[0], seed=2, noise=9)
    findings = study_findings(tmp_path / "main")
    finals = by_seed(findings, RETURN)
    assert sorted(finals[names[0]]) == [0, 1, 2]
    found = repeat(findings, RETURN)
    assert [len(seeds) for seeds in found.values()] == [2, 2, 2]
    for members, (first, second) in found.items():
        zero, one = ({name: finals[name][seed] for name in members} for seed in (0, 1))
        # Of two seeds, each is the other's truth.
        assert first.tau == pytest.approx(second.tau)
        best = max(zero, key=zero.__getitem__)
        assert first.regret == pytest.approx(max(one.values()) - one[best])
    write_study(tmp_path / "one", PAIRS, seeds=1)
    assert not repeat(study_findings(tmp_path / "one"), RETURN)
