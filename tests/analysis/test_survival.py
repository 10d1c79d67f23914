"""Which camera sets survive: means over axes, and whether undisturbed success predicts them."""

from __future__ import annotations

import pandas as pd
import pytest
from study_files import rows_of

from analysis.survival import MODERATE, predictions_table, sets_table, survival
from needlehoop.study.data import paper

AXES = {"camera.shift": 0.2, "robot.late": 1.0}
"""What an axis leaves of success."""
UNDISTURBED = {name: 0.3 + 0.05 * place for place, name in enumerate(paper.measured())}


def _stress(disturb="none", sign=1) -> pd.DataFrame:
    rows = []
    for name, value in UNDISTURBED.items():
        left = {"none": 1.0, **AXES, "all": 0.1}
        for axis, share in left.items():
            success = value * share if sign > 0 else 1 - value * share
            rows.append((disturb, name, "expert", 7, axis, 3, 40, success))
    columns = ["disturb", "cameras", "reward", "seed", "axis", "severity", "episodes", "success"]
    return pd.DataFrame(rows, columns=columns)


def _runs() -> pd.DataFrame:
    rows = [(name, seed, value) for name, value in UNDISTURBED.items() for seed in (7, 8)]
    return pd.DataFrame(rows, columns=["cameras", "seed", "success"])


def test_survival_is_the_mean_over_axes_by_themselves():
    table = survival(_stress())
    shares = table["success"] / table["none"]
    assert shares.tolist() == pytest.approx([0.6] * len(UNDISTURBED))
    assert (table["all"] / table["none"]).tolist() == pytest.approx([0.1] * len(UNDISTURBED))


def test_the_best_survivor_comes_first_and_what_was_not_trained_stays_empty():
    (first, *_, last) = rows_of(sets_table(_runs(), survival(_stress())))
    in_order = sorted(UNDISTURBED, key=UNDISTURBED.__getitem__)
    assert (last["cameras"], first["cameras"]) == (in_order[0], in_order[-1])
    assert [*first.values()][-3:] == ["", "", ""]
    assert first["threaded in Q1, %"] == f"{100 * UNDISTURBED[in_order[-1]]:.0f}"
    assert first["mean over axes, %"] == f"{60 * UNDISTURBED[in_order[-1]]:.0f}"


@pytest.mark.parametrize("sign", [1, -1])
def test_success_predicts_survival_where_it_does(sign):
    both = pd.concat([_stress(sign=sign), _stress(MODERATE, sign)])
    rows = rows_of(predictions_table(_runs(), both))
    assert [row["prediction"] for row in rows] == ["Q1", "Q1, other seeds"] * 5
    for row in rows[:4]:
        assert float(row["ρ (95 %)"].split()[0]) == sign
        assert (float(row["p"]) < 0.01) == (sign > 0)
