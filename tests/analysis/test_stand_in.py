"""Q8: agreement of two ways of training, in all and within the rule's classes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from analysis.runs import is_two_sided
from analysis.stand_in import stand_in_table, within_classes
from needlehoop.study.data import paper

SETS = [*paper.measured()]
RANKED = {name: is_two_sided(name) + place / 100 for place, name in enumerate(SETS)}
"""A success that the rule decides, and within its classes the place."""


def runs(scores, spread: float) -> pd.DataFrame:
    noise = np.random.default_rng(1).uniform(-spread, spread, (len(SETS), 3))
    rows = [
        {"cameras": name, "seed": seed, "success": scores[name] + noise[index, seed]}
        for index, name in enumerate(SETS)
        for seed in range(3)
    ]
    return pd.DataFrame(rows)


def test_an_order_within_the_classes_is_held_against_all_others():
    tau, p = within_classes(RANKED, RANKED)
    ways = {of: sum(is_two_sided(name) is of for name in SETS) for of in (True, False)}
    # Of all orders one alone agrees wholly.
    orders = np.prod([float(np.prod(np.arange(1, n + 1))) for n in ways.values()])
    assert (tau, p) == (pytest.approx(1.0), pytest.approx(1 / orders))
    tau, p = within_classes(RANKED, {name: -value for name, value in RANKED.items()})
    assert (tau, p) == (pytest.approx(-1.0), 1.0)


def test_the_verdict_needs_agreement_beyond_the_rule():
    def verdict(learnt, imitated) -> str:
        return stand_in_table(runs(learnt, 0.001), runs(imitated, 0.001))["a stand-in"].iloc[0]

    reverse = {name: 2 * is_two_sided(name) - RANKED[name] for name in SETS}
    assert verdict(RANKED, RANKED) == "yes"
    assert verdict(RANKED, {**reverse, SETS[0]: RANKED[SETS[0]]}) == "no"
    # The classes apart, and in each an order that agrees by no more than chance.
    pairs = [name for name in SETS if is_two_sided(name)]
    order = dict(zip(pairs, (2, 1, 0, 5, 4, 3, 8, 7, 6), strict=True))
    order |= zip([name for name in SETS if name not in order], (4, 3, 2, 1, 0), strict=True)
    rough = {name: is_two_sided(name) + place / 100 for name, place in order.items()}
    assert verdict(RANKED, rough) == "only as a rule"


def test_a_single_run_of_a_set_has_no_verdict():
    learnt = runs(RANKED, 0.001)
    alone = learnt.loc[(learnt["cameras"] != SETS[3]) | (learnt["seed"] == 0)]
    first = stand_in_table(alone, learnt).iloc[0]
    assert (first["τ-b (95 %)"], first["a stand-in"]) == ("1.00", "too few seeds")
