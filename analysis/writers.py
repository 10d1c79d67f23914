"""Who should write the reward? What the runs of docs/protocol.md say of it (Q6)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import ttest_ind

from analysis.protocol import share
from needlehoop.study.data.paper import HUMAN
from needlehoop.study.render.table import Column, Estimated, Table
from needlehoop.study.stats.statistics import ENOUGH, Interval

WRITERS = {
    HUMAN: "a human",
    "vlm_text": "claude, told by text",
    "vlm_img": "claude, shown an image, too",
}
"""Rewards of the runs, and who wrote them. A run of ``claude``'s has a program of its own."""


def writers_table(runs: pd.DataFrame) -> Table:
    """Each writer's runs, and what they add to the human reward's (Welch's interval)."""
    own = {name: runs[runs["reward"] == name] for name in WRITERS}
    rows = []
    for name, said in WRITERS.items():
        successes, human = (own[one]["success"].tolist() for one in (name, HUMAN))
        added = None
        if name != HUMAN and len(successes) >= ENOUGH:
            ends = ttest_ind(successes, human, equal_var=False).confidence_interval()
            interval = Interval(float(ends.low), float(ends.high))
            added = Estimated(float(np.mean(successes) - np.mean(human)), interval)
        others = (float(np.mean(own[name][column])) for column in ("sampled", "cheat"))
        rows.append((said, successes, share(successes), added, *others))
    columns = (
        Column("who wrote it"), Column("threaded by run", "%", ".0f", 100.0),
        Column.share("mean (95 %)"), Column("more than human, points (95 %)", "", "+.0f", 100.0),
        Column.share("sampled"), Column.share("cheat"),
    )  # fmt: skip
    return Table("writers", "", columns, tuple(rows))
