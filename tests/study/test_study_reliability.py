"""What seeds say of a measured ranking."""

import numpy as np
import pytest
from study_files import PAIRS, write_run, write_study

from needlehoop.study.data.findings import study_findings
from needlehoop.study.report.rankings import agreements
from needlehoop.study.stats.agreement import pooled
from needlehoop.study.stats.measures import RETURN, TRAINING, by_seed
from needlehoop.study.stats.reliability import mean_known, repeat, spread
from needlehoop.study.stats.statistics import iqm, resample


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
    assert found.tau == pytest.approx(np.nanpercentile(taus, (2.5, 97.5)))
    assert found.regret == pytest.approx(np.percentile(regrets, (2.5, 97.5)))
    other = spread_of(sides, seed=1)
    assert other is not None
    assert other != found
    assert other.regret == pytest.approx(found.regret, abs=0.15)


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
    assert found.tau == (pytest.approx(1.0), pytest.approx(1.0))
    assert found.regret == (0.0, 0.0)
    together = pooled([(p, {name: own[0] for name, own in side.items()}) for p, side in same])
    assert (together.tau, together.regret) == (pytest.approx(1.0), 0.0)


def test_what_puts_all_on_one_level_has_regrets_alone():
    level = [(dict.fromkeys(p, 1.0), side) for p, side in lists_of_two()]
    found = spread_of(level)
    assert found is not None
    assert found.tau is None
    assert found.regret[1] > found.regret[0] > 0.0


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
    assert [len(seeds) for seeds in found.lists.values()] == [2, 2, 2]
    for members, (first, second) in found.lists.items():
        zero, one = ({name: finals[name][seed] for name in members} for seed in (0, 1))
        # Of two seeds, each is the other's truth.
        assert first.tau == pytest.approx(second.tau)
        assert first.regret == pytest.approx(
            max(one.values()) - one[max(zero, key=zero.__getitem__)]
        )
    for measure, what in (
        (RETURN, "one seed against the other seeds"),
        (TRAINING, "one seed against the other seeds, return over training"),
    ):
        rows = [row for row in agreements(findings).rows if row[0] == what]
        assert [row[1] for row in rows][-1] == "all lists"
        seeds_of = repeat(findings, measure).lists.values()
        means = [np.mean([one.tau for one in seeds]) for seeds in seeds_of]
        assert [row[2] for row in rows] == [f"{tau:.2f}" for tau in (*means, np.mean(means))]
    assert found.core_minutes is None


def test_one_seed_has_no_others(tmp_path):
    write_study(tmp_path / "main", PAIRS, seeds=1)
    findings = study_findings(tmp_path / "main")
    assert not repeat(findings, RETURN).lists
    assert not [row for row in agreements(findings).rows if row[0].startswith("one seed")]


def test_a_mean_leaves_out_what_is_not_known():
    assert mean_known([1.0, float("nan"), 3.0]) == 2.0
    assert np.isnan(mean_known([float("nan")]))
