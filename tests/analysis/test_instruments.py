"""Cameras on instruments (Q7): verdicts on runs that were made up."""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis import instruments


def _runs(mean) -> pd.DataFrame:
    """Five seeds of Q7's 18 sets; ``mean(views, rendering)`` says how often they thread."""
    rows = []
    for rendering in instruments.RENDERINGS:
        for views in instruments.VIEWS:
            cameras = "+".join(f"{rendering}_{view}" for view in views.split("+"))
            for seed in range(5):
                success = mean(views, rendering) + 0.01 * (seed - 2)
                rows.append({"cameras": cameras, "seed": seed, "success": success})
    return pd.DataFrame(rows)


def test_a_set_is_enough_in_two_renderings_of_three():
    best = {"rgb": 0.8, "seg": 0.8, "dep": 0.3}
    runs = _runs(lambda views, name: best[name] if views == "wrist" else 0.8)
    table = instruments.questions_table(runs).set_index("question")["verdict"]
    verdicts = {name.split(" (")[0]: verdict for name, verdict in table.items()}
    assert verdicts["one camera on the instrument is enough"] == "yes"
    assert verdicts["the endoscope is enough"] == "yes"
    assert verdicts["the instrument's camera adds something"] == "no"
    worse = _runs(lambda views, name: 0.7 if views == "wrist" else 0.8)
    table = instruments.questions_table(worse)
    assert table["verdict"].tolist() == ["no", "yes", "no"]
    assert table.iloc[0, 1].startswith("-10 (")


def test_what_the_instruments_camera_adds_is_pooled_within_renderings():
    # The renderings lie far apart; what is added does not.
    base = {"rgb": 0.1, "seg": 0.5, "dep": 0.8}
    runs = _runs(lambda views, name: base[name] + 0.05 * (views == "ecm_left+wrist"))
    row = instruments.questions_table(runs).iloc[2]
    assert row["verdict"] == "yes"
    assert row["all, points (95 %)"] == "+5 (+4 to +6)"


def test_predictions_are_held_against_each_rendering_by_itself():
    score = dict(zip(instruments.VIEWS, np.linspace(0.9, 0.4, 6), strict=True))
    runs = _runs(lambda views, name: score[views])
    right = {
        name: {c: score[instruments.views_of(c)] for c in runs["cameras"] if c.startswith(name)}
        for name in instruments.RENDERINGS
    }
    wrong = {name: {c: -value for c, value in scores.items()} for name, scores in right.items()}
    table = instruments.predictions_table({"right": right, "wrong": wrong}, runs).set_index(
        "prediction"
    )
    assert table["τ-b, mean"].tolist() == ["1.00", "-1.00"]
    assert table["its first loses, points"].tolist() == ["0", "50"]
