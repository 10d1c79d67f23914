"""Predicted against measured orders: correlations, hits, regret."""

import csv
import math
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau, spearmanr

import needlehoop
from needlehoop.study.stats.agreement import agreement, pooled

PAPER = Path(needlehoop.__file__).parent / "recordings" / "paper" / "table_2.csv"


def named(values) -> dict[str, float]:
    return {f"c{i}": float(value) for i, value in enumerate(values)}


def scores(order) -> dict[str, float]:
    """An order, best first, as scores."""
    return {name: float(len(order) - place) for place, name in enumerate(order)}


@st.composite
def two_sides(draw, most=6):
    size = draw(st.integers(2, most))
    side = st.lists(st.integers(0, 4), min_size=size, max_size=size)
    return draw(side), draw(side)


@given(two_sides())
def test_correlations_are_scipys_ties_included(sides):
    a, b = sides
    found = agreement(named(a), named(b))
    if len(set(a)) == 1 or len(set(b)) == 1:
        assert all(map(math.isnan, (found.tau, found.tau_p, found.rho, found.rho_p)))
        return
    assert found.tau == pytest.approx(kendalltau(a, b).statistic, abs=1e-12)
    assert found.rho == pytest.approx(spearmanr(a, b).statistic, abs=1e-12)


@given(two_sides(most=4))
def test_p_is_the_share_of_orders_at_least_as_strong(sides):
    a, b = sides
    if len(set(a)) == 1 or len(set(b)) == 1:
        return
    found = agreement(named(a), named(b))
    drawn = [
        kendalltau([a[i] for i in order], b).statistic for order in permutations(range(len(a)))
    ]
    share = np.mean([abs(value) >= abs(found.tau) - 1e-9 for value in drawn])
    assert found.tau_p == pytest.approx(share)


def test_the_same_order_agrees_fully_and_the_reverse_not_at_all():
    names = ["a", "b", "c", "d", "e"]
    same = agreement(scores(names), scores(names))
    assert (same.tau, same.rho, same.top_hit, same.bottom_hit, same.regret) == (
        pytest.approx(1.0),
        pytest.approx(1.0),
        True,
        True,
        0.0,
    )
    # This order and its reverse, of 120.
    assert same.tau_p == same.rho_p == pytest.approx(2 / 120)
    reverse = agreement(scores(names[::-1]), scores(names))
    assert reverse.tau == pytest.approx(-1.0)
    assert reverse.tau_p == pytest.approx(2 / 120)
    assert not reverse.top_hit
    assert not reverse.bottom_hit
    assert reverse.regret == 4.0


def test_many_camera_sets_are_sampled_with_a_seed():
    rising = named(range(14))
    found = agreement(rising, rising)
    assert found == agreement(rising, rising)
    assert 0 < found.tau_p < 1e-3
    noisy = named(np.random.default_rng(0).permutation(14))
    assert agreement(noisy, rising).tau_p == pytest.approx(
        kendalltau(list(noisy.values()), list(rising.values())).pvalue, abs=0.01
    )


def test_a_tie_at_the_top_hits_only_if_all_of_it_is_best():
    measured = {"a": 3.0, "b": 1.0, "c": 0.0}
    tied = agreement({"a": 2.0, "b": 2.0, "c": 1.0}, measured)
    assert not tied.top_hit
    assert tied.regret == pytest.approx(1.0)
    assert tied.bottom_hit
    both = agreement({"a": 2.0, "b": 2.0, "c": 1.0}, {"a": 3.0, "b": 3.0, "c": 0.0})
    assert both.top_hit
    assert both.regret == 0.0


def test_a_tie_at_the_bottom_hits_only_if_all_of_it_is_worst():
    tied = {"a": 2.0, "b": 1.0, "c": 1.0}
    assert not agreement(tied, {"a": 3.0, "b": 1.0, "c": 0.0}).bottom_hit
    assert agreement(tied, {"a": 3.0, "b": 0.0, "c": 0.0}).bottom_hit


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="b, c on one side only"):
        agreement({"a": 1.0, "b": 2.0}, {"a": 1.0, "c": 2.0})


def test_one_camera_set_has_no_correlation():
    alone = agreement({"a": 1.0}, {"a": 2.0})
    assert math.isnan(alone.tau)
    assert math.isnan(alone.rho_p)
    assert alone.regret == 0.0


def test_lists_that_say_little_alone_say_more_together():
    three = scores(["a", "b", "c"]), {"a": 3.0, "b": 2.0, "c": 1.0}
    assert agreement(*three).tau_p == pytest.approx(2 / 6)
    both = pooled([three, three])
    # Of 36 pairs of orders one agrees fully, and one disagrees fully.
    assert both.tau == both.rho == pytest.approx(1.0)
    assert both.tau_p == pytest.approx(2 / 36, abs=0.005)
    assert both.rho_p == pytest.approx(2 / 36, abs=0.005)
    assert (both.n, both.lists, both.regret) == (6, 2, 0.0)
    assert both.top_hit
    assert both.bottom_hit
    assert pooled([three, three]) == both


@given(st.lists(two_sides(), min_size=1, max_size=3))
def test_lists_together_are_the_mean_of_those_that_say_something(sides):
    alone = [agreement(named(a), named(b)) for a, b in sides]
    both = pooled([(named(a), named(b)) for a, b in sides])
    told = [one for one in alone if not math.isnan(one.tau)]
    if told:
        assert both.tau == pytest.approx(np.mean([one.tau for one in told]))
        assert both.rho == pytest.approx(np.mean([one.rho for one in told]))
    else:
        assert math.isnan(both.tau)
        assert math.isnan(both.tau_p)
    if len(told) == 1:
        assert both.tau_p == told[0].tau_p
    assert both.regret == pytest.approx(np.mean([one.regret for one in alone]))
    assert both.top_hits == sum(one.top_hit for one in alone)
    assert both.bottom_hits == sum(one.bottom_hit for one in alone)


def test_the_papers_statement_holds_on_its_own_table():
    """It says that best and worst were predicted in all three lists."""
    with PAPER.open(newline="") as file:
        rows = list(csv.DictReader(file))
    found = {}
    for name in ("rgb_dep", "rgb_seg", "dep_seg"):
        own = [row for row in rows if row["list"] == name]
        found[name] = agreement(
            {row["cameras"]: -float(row["predicted_rank"]) for row in own},
            {row["cameras"]: float(row["measured_return"]) for row in own},
        )
    assert [f.n for f in found.values()] == [5, 5, 6]
    assert all(f.top_hit and f.bottom_hit and f.regret == 0 for f in found.values())
    # What lies between is not predicted well enough to rule chance out.
    assert found["rgb_dep"].tau == pytest.approx(0.6)
    assert found["rgb_seg"].tau == pytest.approx(0.6)
    assert found["dep_seg"].tau == pytest.approx(0.6)
    assert all(f.tau_p > 0.05 for f in found.values())
