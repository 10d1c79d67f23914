"""Q9: which of four programs goes on."""

from __future__ import annotations

import pandas as pd
import pytest
from study_files import change, write_run

from analysis import recipe


def test_lifts_count_over_the_last_steps_and_by_episodes():
    metrics = pd.DataFrame(
        {
            "step": [90_000, 110_000, 140_000, 150_400],
            "episodes": [100, 30, 10, 0],
            "lifted": [1.0, 0.0, 0.4, float("nan")],
        }
    )
    assert recipe.lifted(metrics) == pytest.approx(0.1)


def test_near_ties_are_broken_by_the_human_reward():
    programs = pd.DataFrame(
        {
            "sample": [5, 6, 7, 8],
            "lifted": [0.016, 0.012, 0.02, 0.0],
            "return_human": [4.0, 5.0, 3.0, 9.0],
        }
    )
    assert recipe.kept(programs) == 6
    programs.loc[0, "lifted"] = 0.2
    assert recipe.kept(programs) == 5


def test_an_agent_that_went_on_is_refused(tmp_path):
    run = write_run(tmp_path / "study", "dep_front+seg_side", "vlm_img", seed=10)
    change(run / "config.yaml", reward={"sample": 1})
    with pytest.raises(ValueError, match="stands at 993280 steps, not 150000"):
        recipe.add(tmp_path, tmp_path / "study")
    assert not (tmp_path / recipe.TABLE).exists()
