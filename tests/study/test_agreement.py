"""Predicted against measured orders: correlations, hits, regret."""

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau, spearmanr

from needlehoop.study.stats.agreement import agreement


def named(values) -> dict[str, float]:
    return {f"c{i:02d}": float(value) for i, value in enumerate(values)}


@st.composite
def two_sides(draw, most=6):
    size = draw(st.integers(2, most))
    side = st.lists(st.integers(0, 4), min_size=size, max_size=size)
    return draw(side), draw(side)


@given(two_sides())
def test_correlations_are_scipys_ties_included(sides):
    a, b = sides
    fit = agreement((named(a), named(b)))
    if len(set(a)) == 1 or len(set(b)) == 1:
        assert all(map(math.isnan, (fit.tau, fit.tau_p, fit.rho, fit.rho_p)))
        return
    assert fit.tau == pytest.approx(kendalltau(a, b).statistic, abs=1e-12)
    assert fit.rho == pytest.approx(spearmanr(a, b).statistic, abs=1e-12)


@given(two_sides(most=4))
def test_p_is_the_share_of_orders_at_least_as_strong(sides):
    a, b = sides
    if len(set(a)) == 1 or len(set(b)) == 1:
        return
    fit = agreement((named(a), named(b)))
    drawn = [
        kendalltau([a[i] for i in order], b).statistic for order in permutations(range(len(a)))
    ]
    share = np.mean([abs(value) >= abs(fit.tau) - 1e-9 for value in drawn])
    assert fit.tau_p == pytest.approx(share)


def test_many_camera_sets_are_sampled_with_a_seed():
    rising = named(range(14))
    noisy = named(np.random.default_rng(0).permutation(14))
    fit = agreement((noisy, rising))
    assert fit == agreement((dict(reversed(noisy.items())), rising))
    scipys = kendalltau(list(noisy.values()), list(rising.values())).pvalue
    assert fit.tau_p == pytest.approx(scipys, abs=0.01)


def test_a_tie_at_an_end_hits_only_if_all_of_it_is_right():
    measured = {"a": 3.0, "b": 1.0, "c": 0.0}
    tied = agreement(({"a": 2.0, "b": 2.0, "c": 1.0}, measured))
    assert (tied.top_hits, tied.bottom_hits, tied.regret) == (0, 1, 1.0)
    both = agreement(({"a": 2.0, "b": 2.0, "c": 1.0}, {"a": 3.0, "b": 3.0, "c": 0.0}))
    assert (both.top_hits, both.regret) == (1, 0.0)
    assert agreement(({"a": 2.0, "b": 1.0, "c": 1.0}, measured)).bottom_hits == 0


def test_lists_that_say_little_alone_say_more_together():
    three = named([3, 2, 1]), named([3, 2, 1])
    assert agreement(three).tau_p == pytest.approx(2 / 6)
    both = agreement(three, three)
    # Of 36 pairs of orders one agrees fully, and one disagrees fully.
    assert both.tau == both.rho == 1.0
    assert both.tau_p == pytest.approx(2 / 36, abs=0.005)
    assert (both.lists, both.regret, both.top_hits) == (2, 0.0, 2)
    # A list without a correlation is left out of the mean.
    level = named([1, 1, 1]), named([3, 2, 1])
    assert agreement(three, level).tau_p == agreement(three).tau_p
