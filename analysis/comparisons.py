"""What cameras are worth: what a set shows, and the paper's ten comparisons of sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import statsmodels.api as sm

from needlehoop.study.data import paper
from needlehoop.study.render.table import Estimated
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.run import Measure
from needlehoop.study.stats.statistics import Interval


def is_two_sided(cameras: str) -> bool:
    """Whether a camera set has a front and a side view."""
    return {"front", "side"} <= {one.partition("_")[2] for one in cameras.split("+")}


def has_depth(cameras: str) -> bool:
    """Whether a camera of the set shows depth."""
    return any(one.startswith(("dep_", "segdep_")) for one in cameras.split("+"))


def has_labels(cameras: str) -> bool:
    """Whether a camera of the set shows segmentation."""
    return any(one.startswith("seg") for one in cameras.split("+"))


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


def claims(findings: StudyFindings, measure: Measure) -> dict[Claim, Estimated]:
    """The difference of each claim whose camera sets have all been trained with the main reward.

    By the means of each side's sets, where every set has one by its runs. How far runs of one set
    lie apart is pooled over all sets; there is an interval where each set of a claim has ``_LEAST``
    runs or more.
    """
    runs = findings.by_set(measure)
    names = [*runs]
    values = np.concatenate([*runs.values()]) if runs else np.array([])
    of_set = np.repeat(np.arange(len(names)), [len(own) for own in runs.values()])
    fit = sm.OLS(values, np.eye(len(names))[of_set]).fit() if names else None
    found = {}
    for claim in CLAIMS:
        sets = (*claim.better, *claim.worse)
        if fit is None or not {*sets} <= set(names):
            continue
        weights = np.zeros(len(names))
        weights[[names.index(name) for name in claim.better]] = 1 / len(claim.better)
        weights[[names.index(name) for name in claim.worse]] = -1 / len(claim.worse)
        interval = None
        if min(len(runs[name]) for name in sets) >= _LEAST:
            low, high = fit.t_test(weights).conf_int()[0]
            interval = Interval(float(low), float(high))
        found[claim] = Estimated(float(weights @ fit.params), interval)
    return found
