"""IQM and intervals against values worked out in other ways."""

import numpy as np
import pytest

from needlehoop.study.stats.statistics import Estimated, difference, estimate, iqm, rate


def ends_of(estimated: Estimated) -> tuple[float, float]:
    assert estimated.interval is not None
    return estimated.interval.low, estimated.interval.high


def test_the_iqm_is_the_mean_of_the_middle_half_of_ten_values_or_more():
    assert iqm(np.array([100.0, 3.0, 2.0, -50.0])) == pytest.approx(13.75)
    assert iqm(np.arange(12.0)) == pytest.approx(5.5)
    assert iqm(np.array([0.0] * 9 + [1.0, 1.0, 900.0])) == 0.0


def test_too_few_seeds_have_no_interval():
    estimated = estimate([8.5])
    assert (estimated.value, estimated.interval, estimated.seeds) == (8.5, None, 1)
    assert estimated.interval_or_why == "one seed, no interval"
    assert estimate([8.5, 8.7]).interval_or_why == "2 seeds, no interval"


def test_a_rate_of_few_seeds_has_wilsons_interval_over_its_episodes():
    estimated = rate([0.9, 0.8], [100, 100])
    assert (estimated.value, estimated.seeds) == (pytest.approx(0.85), 2)
    # Worked out from the formula of the score interval for 170 of 200.
    assert ends_of(estimated) == pytest.approx((0.7939, 0.8929), abs=1e-4)
    assert estimated.interval is not None
    assert estimated.interval.over_episodes
    # Episodes count, not runs.
    assert rate([1.0, 0.0], [300, 100]).value == pytest.approx(0.75)
    three = rate([0.9, 0.8, 0.7], [100, 100, 100])
    assert ends_of(three) == pytest.approx((0.5516, 1.0), abs=1e-4)
    assert three.interval is not None
    assert not three.interval.over_episodes


def test_a_few_seeds_have_students_interval():
    # 4.303 is the 97.5 % point of t with two degrees of freedom, from a printed table.
    estimated = estimate([1.0, 2.0, 6.0])
    half = 4.303 * np.sqrt(7.0 / 3.0)
    assert ends_of(estimated) == pytest.approx((3.0 - half, 3.0 + half), abs=1e-3)


def test_many_seeds_have_the_percentiles_of_their_resamples():
    many = list(np.random.default_rng(0).normal(5.0, 1.0, 40))
    estimated = estimate(many)
    low, high = ends_of(estimated)
    assert min(many) < low < 5.0 < high < max(many)
    assert 0.5 < high - low < 1.2
    assert estimate(many) == estimated


def test_a_difference_of_shares_has_newcombes_interval():
    less = difference(rate([0.9], [100]), rate([0.7], [100]))
    assert less.value == pytest.approx(-0.2)
    assert ends_of(less) == pytest.approx((-0.3071, -0.0905), abs=2e-3)
    assert difference(estimate([1.0]), rate([0.7], [100])).interval is None
