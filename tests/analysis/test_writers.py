"""Rewards of several writers, held against intervals worked out by hand."""

import numpy as np
import pandas as pd
import pytest
from study_files import cells_of

from analysis.writers import WRITERS, writers_table

SUCCESS = {
    "human": [0.9, 0.8, 0.7],
    "vlm_text": [0.9, 0.8, 0.7],
    "vlm_img": [0.6, 0.5, 0.1],
}


def test_a_writer_is_held_against_the_human_by_runs():
    rows = [
        {"reward": reward, "success": success, "sampled": 0.5, "cheat": 0.25}
        for reward, own in SUCCESS.items()
        for success in own
    ]
    human, text, image = cells_of(writers_table(pd.DataFrame(rows)))
    assert [row["who wrote it"] for row in (human, text, image)] == [*WRITERS.values()]
    added = "more than human, points (95 %)"
    assert human[added] is None
    # Welch's: the same scatter on both sides has 4 degrees of freedom, which are 2.776 errors.
    half = 2.7764 * 0.1 * np.sqrt(2 / 3)
    assert text[added].value == pytest.approx(0.0)
    assert text[added].interval.high == pytest.approx(half, abs=1e-3)
    assert image[added].value == pytest.approx(-0.4)
    assert image[added].interval.low < -0.9
    assert image["threaded by run, %"] == SUCCESS["vlm_img"]
    assert (image["sampled, %"], image["cheat, %"]) == (0.5, 0.25)
