"""The paper's comparisons and the writers of rewards, against values worked out in other ways."""

import numpy as np
import pandas as pd
import pytest
from study_files import change, rows_of, write_run

from analysis.comparisons import WRITERS, claims, writers_table
from needlehoop.study.stats.findings import study_findings
from needlehoop.study.stats.run import RETURN


@pytest.mark.parametrize(
    ("front", "side", "quantile"),
    [
        ([8.0, 8.2, 8.1], [5.0, 5.5, 5.2], 2.7764),
        ([8.0, 8.1], [5.0, 5.2], 4.3027),
        ([5.0], [8.0, 8.1, 8.2], None),
    ],
)
def test_a_claim_has_students_interval_of_the_sets_pooled_scatter(tmp_path, front, side, quantile):
    for cameras, values in (("dep_front+rgb_side", front), ("rgb_front+dep_side", side)):
        for seed, value in enumerate(values):
            run = write_run(tmp_path, cameras, seed=seed, updates=2, steps=20_480)
            change(run / "evaluation.json", **{"return": value})
    # Others' sets have not been trained.
    ((claim, estimated),) = claims(study_findings(tmp_path), RETURN).items()
    assert claim.text == "depth is better in front than at the side"
    assert estimated.value == pytest.approx(np.mean(front) - np.mean(side))
    if quantile is None:
        assert estimated.interval is None
        return
    squares = sum(float(np.var(values)) * len(values) for values in (front, side))
    free = len(front) + len(side) - 2
    error = np.sqrt(squares / free * (1 / len(front) + 1 / len(side)))
    assert estimated.interval is not None
    assert estimated.interval.high == pytest.approx(estimated.value + quantile * error, abs=1e-3)


def test_a_writer_is_held_against_the_human_by_runs():
    success = {"human": [0.9, 0.8, 0.7], "vlm_text": [0.9, 0.8, 0.7], "vlm_img": [0.6, 0.5, 0.1]}
    rows = [
        {"reward": reward, "success": share, "sampled": 0.5, "cheat": 0.25}
        for reward, shares in success.items()
        for share in shares
    ]
    human, text, image = rows_of(writers_table(pd.DataFrame(rows)))
    assert [row["who wrote it"] for row in (human, text, image)] == [*WRITERS.values()]
    added = "more than human, points (95 %)"
    assert human[added] == ""
    # Welch's: the same scatter on both sides has 4 degrees of freedom, which are 2.776 errors.
    half = 277.64 * 0.1 * np.sqrt(2 / 3)
    assert text[added].replace("-0", "+0") == f"+0 (-{half:.0f} to +{half:.0f})"
    assert image[added].startswith("-40 (")
    assert image["threaded by run, %"] == "60, 50, 10"
    assert (image["sampled, %"], image["cheat, %"]) == ("50", "25")
