"""Where to put a camera: rules that are computed, and rankings that are held against training."""

from __future__ import annotations

import pandas as pd
import pytest
from study_files import rows_of

from analysis.placements import (
    ALONE,
    APART,
    CAMERAS,
    ELEVATION,
    HIDDEN,
    MODEL,
    PIXELS,
    pair_scores,
    places_table,
    predictions_table,
    scores,
)


def test_a_pair_is_scored_by_its_two_cameras():
    singles = pd.DataFrame([{"cameras": name, "success": i / 20} for i, name in enumerate(CAMERAS)])
    pair, single = pair_scores(singles).loc["rgb_p05+rgb_p10"], scores()
    for rule in (PIXELS, HIDDEN, ELEVATION):
        assert pair[rule] == pytest.approx(single.loc[["rgb_p05", "rgb_p10"], rule].mean())
    assert pair[ALONE] == pytest.approx((4 + 9) / 2 / 20)
    # Both 34 degrees up, 174 degrees of azimuth apart.
    assert pair[APART] == pytest.approx(-(111.8 - 90.0), abs=0.1)
    runs = pd.DataFrame([{"cameras": "rgb_p05+rgb_p10", "success": 0.8, "sampled": 0.9}])
    (row,) = rows_of(places_table(runs))
    assert (row["azimuth, °"], row["threaded by seed, %"]) == ("30, -144", "80")


def test_a_ranking_is_held_against_mean_success():
    success = {"a": [0.9, 0.8], "b": [0.6, 0.7], "c": [0.4, 0.5], "d": [0.1, 0.2], "e": [0.0, 0.1]}
    runs = pd.DataFrame(
        [{"cameras": name, "success": s} for name, shares in success.items() for s in shares]
    )
    right = [5.0, 4.0, 3.0, 2.0, 1.0]
    scores = {MODEL: right, PIXELS: right[::-1], HIDDEN: right[::-1], ELEVATION: right[::-1]}
    table = rows_of(predictions_table(pd.DataFrame(scores, index=[*success]), runs))
    rows = {row["prediction"]: row for row in table}
    assert rows[MODEL]["ρ (95 %)"].startswith("1.00 (")
    assert rows[PIXELS]["ρ (95 %)"].startswith("-1.00 (")
    assert float(rows[MODEL]["p"]) == pytest.approx(1 / 120, abs=0.002)
    assert rows[PIXELS]["p"] == "1.00"
    assert (rows[MODEL]["regret, points"], rows[PIXELS]["regret, points"]) == ("0", "80")
    assert rows["picked at random"]["regret, points"] == "42"
    assert int(rows[MODEL]["above the best rule, %"]) > 95
    assert rows[PIXELS]["above the best rule, %"] == ""
