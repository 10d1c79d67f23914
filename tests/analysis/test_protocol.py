"""The protocol's tests: what a prediction knows that the rule does not, traits, camera sets."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from study_files import rows_of

from analysis.protocol import (
    TRAITS,
    beating,
    best_table,
    changes_table,
    mean_tau,
    p_within_classes,
    sets_table,
    traits_table,
)
from analysis.runs import is_two_sided
from needlehoop.study.data import paper

LISTS = list(paper.lists().values())
MEASURED = {
    name: is_two_sided(name) + place / 100
    for place, name in enumerate(sorted({name for names in LISTS for name in names}))
}


def test_the_rule_itself_knows_nothing_within_its_classes():
    rule = [{name: float(is_two_sided(name)) for name in names} for names in LISTS]
    assert mean_tau(rule, MEASURED) > 0.5
    assert p_within_classes(rule, MEASURED) == 1.0


def test_a_ranking_that_is_right_within_the_classes_knows_more_and_its_reverse_does_not():
    right = [{name: MEASURED[name] for name in names} for names in LISTS]
    assert mean_tau(right, MEASURED) == pytest.approx(1.0)
    assert p_within_classes(right, MEASURED) < 0.01
    within = [{name: 2 * is_two_sided(name) - MEASURED[name] for name in names} for names in LISTS]
    assert mean_tau(within, MEASURED) > 0.0
    assert p_within_classes(within, MEASURED) > 0.9


def _runs(success) -> pd.DataFrame:
    rows = []
    for name in paper.measured():
        cameras = name.split("+")
        traits = {
            "two_views": is_two_sided(name),
            "depth": any(c.startswith("dep_") for c in cameras),
            "labels": any(c.startswith("seg_") for c in cameras),
        }
        for seed in range(5):
            value = success(traits, seed)
            rows.append({"cameras": name, "seed": seed, "success": value, "sampled": value,
                         "touched": value, **traits})  # fmt: skip
    return pd.DataFrame(rows)


def test_what_traits_add_is_found_with_its_interaction():
    draw = np.random.default_rng(0)

    def success(traits, seed):
        both = traits["depth"] and traits["labels"]
        plain = 0.2 + 0.4 * traits["two_views"] + 0.2 * traits["depth"] + 0.1 * traits["labels"]
        return plain - 0.15 * both + 0.01 * draw.standard_normal()

    rows = rows_of(traits_table(_runs(success)))
    assert [row["what is added"] for row in rows] == [*TRAITS.values()]
    for row, true in zip(rows, (40, 20, 10, -15), strict=True):
        value, low, high = map(int, re.findall(r"[+-]\d+", row["success, points (95 %)"]))
        assert value == pytest.approx(true, abs=3)
        assert low <= value <= high


def test_camera_sets_are_told_apart_by_runs_not_by_episodes():
    runs = _runs(lambda traits, seed: 0.5 + 0.4 * traits["two_views"] + 0.02 * (seed - 1))
    table = rows_of(sets_table(runs))
    assert len(table) == 14
    assert table[0]["threaded by seed, %"] == "88, 90, 92, 94, 96"
    assert table[0]["exact p"] == ""
    assert table[-1]["the best set's chance to beat it"] == "1.00"
    # Two of the 252 ways to share ten runs out put all high ones on one side.
    assert table[-1]["exact p"] == "0.008"
    # Student's of five runs: 92 +- 2.776 * 3.16 / sqrt(5).
    assert table[0]["mean (95 %), %"] == "92 (88 to 96)"


def test_the_test_of_two_sets_counts_ties_and_few_runs_as_they_are():
    assert beating([0.5, 0.5, 0.5], [0.5, 0.5, 0.5])["exact p"] == "1.00"
    # Of three runs that all beat three, one order of ten says so, and its mirror image.
    assert beating([0.7, 0.8, 0.9], [0.1, 0.2, 0.3]) == {
        "chance to beat it": "1.00",
        "exact p": "0.10",
    }
    # By hand: 4 of the 6 pairs are won and two are ties.
    assert beating([3.0, 2.0, 2.0], [1.0, 2.0])["chance to beat it"] == "0.83"


def test_the_best_set_is_judged_by_a_seed_that_did_not_choose_it():
    names = ["rgb_default", "dep_front+seg_side"]
    success = {names[0]: [1.0, 0.4, 0.4], names[1]: [0.5, 0.5, 0.5]}
    runs = pd.DataFrame(
        {"cameras": name, "seed": seed, "success": share}
        for name, shares in success.items()
        for seed, share in enumerate(shares)
    )
    table = rows_of(best_table(runs))
    # Seed 0 alone lifts the first set's mean, and is left out of its own choice.
    assert [row["best in the other seeds"] for row in table] == [names[1], names[0], names[0], ""]
    assert [row["threaded in the seed left out, %"] for row in table] == ["50", "40", "40", "43"]


def test_other_renderings_stand_beside_colour_in_the_same_views():
    runs = _runs(lambda traits, seed: 0.5 + 0.2 * traits["depth"] - 0.1 * traits["labels"])
    rows = {(row["colour alone"], row["instead"]): row for row in rows_of(changes_table(runs))}
    assert len(rows) == 4 + 8
    depth, labels = rows["rgb_default", "dep_default"], rows["rgb_default", "seg_default"]
    assert (depth["adds, points"], labels["adds, points"]) == ("+20", "-10")
    assert (depth["chance to beat it"], labels["chance to beat it"]) == ("1.00", "0.00")
    assert ("rgb_front+rgb_side", "dep_default") not in rows
