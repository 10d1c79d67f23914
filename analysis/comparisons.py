"""The paper's ten comparisons of camera sets, and who should write the reward (Q6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import statsmodels.api as sm

from analysis.protocol import more
from needlehoop.study.data import paper
from needlehoop.study.render.table import percent, written
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.statistics import ENOUGH, Estimated, Interval, share

_LEAST = 2
"""Seeds of a camera set from which on they say how far its runs lie apart."""


@dataclass(frozen=True)
class Claim:
    """That some camera sets do better than others: by the mean of each side's returns."""

    text: str
    better: tuple[str, ...]
    worse: tuple[str, ...]

    @property
    def published(self) -> tuple[float, float]:
        """The paper's own means of the two sides."""
        known = paper.measured()
        better, worse = (float(np.mean([known[c] for c in s])) for s in (self.better, self.worse))
        return better, worse


_COLOUR = ("rgb_front+rgb_side",)
_DEPTH = ("dep_front+rgb_side", "rgb_front+dep_side")
_SEGMENTATION = ("rgb_front+seg_side", "seg_front+rgb_side")
_SAME = ("dep_front+dep_side", "seg_front+seg_side")
_BEST, _REVERSED = ("dep_front+seg_side",), ("seg_front+dep_side",)
_SINGLE = ("rgb_default", "dep_default", "seg_default")
_TWICE, _TWO_KINDS = ("rgb_default+dep_default",), ("rgb_default+seg_default",)
_PAIRS = (*_COLOUR, *_DEPTH, *_SEGMENTATION, *_SAME, *_BEST, *_REVERSED)

CLAIMS = (
    Claim("front and side views together beat single cameras", _PAIRS, _SINGLE),
    Claim("depth beside colour beats colour alone", _DEPTH, _COLOUR),
    Claim("depth is better in front than at the side", _DEPTH[:1], _DEPTH[1:]),
    Claim("depth beside colour wants two views, not one twice", _DEPTH, _TWICE),
    Claim("segmentation beside colour beats colour alone", _SEGMENTATION, _COLOUR),
    Claim("segmentation is better at the side than in front", _SEGMENTATION[:1], _SEGMENTATION[1:]),
    Claim("segmentation beside colour helps even from one view", _TWO_KINDS, _SINGLE[:1]),
    Claim("depth in front with segmentation at the side beats the reverse", _BEST, _REVERSED),
    Claim("depth with segmentation beats two of the same", _BEST, _SAME),
    Claim("one segmentation camera beats one of colour", _SINGLE[2:], _SINGLE[:1]),
)
"""What the paper's discussion says of its camera sets (section V), in its order."""


def claims(findings: StudyFindings, measure: str) -> dict[Claim, Estimated]:
    """The difference of each claim whose camera sets have all been trained with the main reward.

    By the means of each side's sets, where every set has one by its runs. How far runs of one set
    lie apart is pooled over all sets; there is an interval where each set of a claim has ``_LEAST``
    runs or more.
    """
    runs = findings.by_set(measure)
    names = [*runs]
    values = np.concatenate([*runs.values()])
    of_set = np.repeat(np.arange(len(names)), [len(group) for group in runs.values()])
    fit = sm.OLS(values, np.eye(len(names))[of_set]).fit()
    differences = {}
    for claim in CLAIMS:
        sets = (*claim.better, *claim.worse)
        if not {*sets} <= {*names}:
            continue
        weights = np.zeros(len(names))
        weights[[names.index(name) for name in claim.better]] = 1 / len(claim.better)
        weights[[names.index(name) for name in claim.worse]] = -1 / len(claim.worse)
        interval = None
        if min(len(runs[name]) for name in sets) >= _LEAST:
            low, high = fit.t_test(weights).conf_int()[0]
            interval = Interval(float(low), float(high))
        differences[claim] = Estimated(float(weights @ fit.params), interval)
    return differences


WRITERS = {
    paper.HUMAN: "a human",
    "vlm_text": "claude, told by text",
    "vlm_img": "claude, shown an image, too",
}
"""Rewards of the runs, and who wrote them. A run of ``claude``'s has a program of its own."""


def writers_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Each writer's runs, and what they add to the human reward's (Welch's interval)."""
    human = runs[runs["reward"] == paper.HUMAN]["success"].tolist()
    rows = []
    for name, writer in WRITERS.items():
        group = runs[runs["reward"] == name]
        successes, added = group["success"].tolist(), None
        if name != paper.HUMAN and len(successes) >= ENOUGH:
            added = more(successes, human)
        rows.append(
            {
                "who wrote it": writer,
                "threaded by run, %": percent(successes),
                "mean (95 %), %": percent(share(successes)),
                "more than human, points (95 %)": written(added, "+.0f", 100.0),
                "sampled, %": percent(float(np.mean(group["sampled"]))),
                "cheat, %": percent(float(np.mean(group["cheat"]))),
            }
        )
    return pd.DataFrame(rows)
