"""Where to put a camera: rules that are computed, and rankings that are held against training."""

from __future__ import annotations

import pandas as pd
import pytest
from study_files import cells_of

from analysis.placements import (
    ALONE,
    APART,
    CAMERAS,
    ELEVATION,
    FRONT,
    HIDDEN,
    MODEL,
    PIXELS,
    foretold_table,
    pair_scores,
    places_figure,
    places_table,
    rules,
    scores,
    single_scores,
)


def test_a_camera_behind_the_arm_sees_less_of_needle_and_hoop():
    behind, beside = (found for _, found in rules(["rgb_p08", "rgb_p13"]).iterrows())
    assert behind[ELEVATION] == -22.0
    assert beside[ELEVATION] == -6.0
    assert behind[PIXELS] < beside[PIXELS]
    assert 0.0 < behind[HIDDEN] < beside[HIDDEN] <= 1.0
    kept = scores()
    assert [*kept.index] == CAMERAS
    assert kept.loc["rgb_p13", [PIXELS, HIDDEN]].tolist() == pytest.approx(
        [beside[PIXELS], beside[HIDDEN]], abs=1e-4
    )
    assert kept[MODEL].idxmax() == "rgb_p10"


def test_a_pair_is_scored_by_its_two_cameras():
    singles = pd.DataFrame([{"cameras": name, "success": i / 20} for i, name in enumerate(CAMERAS)])
    pair, single = pair_scores(singles).loc["rgb_p05+rgb_p10"], scores()
    for rule in (PIXELS, HIDDEN, ELEVATION):
        assert pair[rule] == pytest.approx(single.loc[["rgb_p05", "rgb_p10"], rule].mean())
    assert pair[ALONE] == pytest.approx((4 + 9) / 2 / 20)
    # Both 34 degrees up, 174 degrees of azimuth apart.
    assert pair[APART] == pytest.approx(-(111.8 - 90.0), abs=0.1)
    runs = pd.DataFrame([{"cameras": "rgb_p05+rgb_p10", "success": 0.8, "sampled": 0.9}])
    (row,) = cells_of(places_table(runs))
    assert (row["azimuth, °"], row["threaded by seed, %"]) == ([30.0, -144.0], [0.8])


def test_the_figure_has_every_place_and_every_pair():
    singles, pairs = (
        pd.DataFrame([{"cameras": name, "success": i / 20} for i, name in enumerate(names)])
        for names in (CAMERAS, scores(2).index)
    )
    right, polar = places_figure(singles, pairs).axes
    assert sorted(text.get_text() for text in polar.texts) == sorted(str(5 * i) for i in range(20))
    pair, better = (line.get_xdata() for line in right.lines)
    assert [*pair] == pytest.approx([5 * i for i in range(20)])
    # The second of p01 and p10.
    assert better[[*scores(2).index].index("rgb_p01+rgb_p10")] == pytest.approx(45)


def test_a_ranking_is_held_against_mean_success():
    success = {"a": [0.9, 0.8], "b": [0.6, 0.7], "c": [0.4, 0.5], "d": [0.1, 0.2], "e": [0.0, 0.1]}
    runs = pd.DataFrame(
        [{"cameras": name, "success": one} for name, own in success.items() for one in own]
    )
    right = [5.0, 4.0, 3.0, 2.0, 1.0]
    scores = {MODEL: right, PIXELS: right[::-1], HIDDEN: right[::-1], ELEVATION: right[::-1]}
    table = cells_of(foretold_table(pd.DataFrame(scores, index=[*success]), runs))
    rows = {row["prediction"]: row for row in table}
    assert rows[MODEL]["ρ (95 %)"].value == pytest.approx(1.0)
    assert rows[PIXELS]["ρ (95 %)"].value == pytest.approx(-1.0)
    assert rows[MODEL]["p"] == pytest.approx(1 / 120, abs=0.005)
    assert rows[PIXELS]["p"] == pytest.approx(1.0)
    assert rows[MODEL]["regret, points"] == 0.0
    assert rows[PIXELS]["regret, points"] == pytest.approx(0.8)
    assert rows["drawn blindly"]["regret, points"] == pytest.approx(0.85 - 0.43)
    assert rows[MODEL]["above the best rule, %"] > 0.95
    assert rows[PIXELS]["above the best rule, %"] is None


def test_the_front_is_nearer_from_either_side():
    near = single_scores()[FRONT]
    assert near["rgb_p06"] == -2.0
    assert near["rgb_p03"] == -34.0
    assert near.idxmin() == "rgb_p13"
