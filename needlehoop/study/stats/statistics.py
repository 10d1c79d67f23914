"""Statistics over seeds: means and their intervals.

A few runs have a mean with Student's interval. From ten on they have an interquartile mean with a
percentile bootstrap over runs, after Agarwal et al., "Deep RL at the Edge of the Statistical
Precipice" (2021).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

# Its ``stats`` are imported at their first use: ``needlehoop status`` does not wait for them.
import scipy

_RESAMPLES = 2_000

FEW = 10
"""Runs below which there is no resampling: percentiles of three runs' resamples are the runs' own
minimum and maximum, which cover three quarters and not 95 %."""

ENOUGH = 3
"""Seeds below which there is no interval: that of two would be their minimum and maximum."""


@dataclass(frozen=True)
class Interval:
    """The ends of a 95 % interval."""

    low: float
    high: float
    over_episodes: bool = False
    """Whether it is over the episodes of too few seeds; else it is over seeds."""


@dataclass(frozen=True)
class Estimated:
    """A value, and where it is known how sure it is."""

    value: float
    interval: Interval | None = None
    seeds: int = 1

    @property
    def interval_or_why(self) -> Interval | str:
        """The interval, or in words why there is none."""
        seeds = "one seed" if self.seeds == 1 else f"{self.seeds} seeds"
        return self.interval or f"{seeds}, no interval"


def iqm(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Mean of the middle half; of fewer than ``FEW`` values, the mean of all of them."""
    return scipy.stats.trim_mean(values, 0.0 if values.shape[axis] < FEW else 0.25, axis=axis)


def estimate(values: Sequence[float] | np.ndarray) -> Estimated:
    """The IQM over runs ``(n,)``; of fewer than ``FEW`` their mean, with Student's interval."""
    sample = np.asarray(values, dtype=float)
    n, value = len(sample), float(iqm(sample))
    if n < ENOUGH:
        return Estimated(value, None, n)
    if n < FEW:
        half = float(scipy.stats.t.ppf(0.975, n - 1) * sample.std(ddof=1) / np.sqrt(n))
        return Estimated(value, Interval(value - half, value + half), n)
    picks = np.random.default_rng(0).integers(n, size=(_RESAMPLES, n))
    low, high = np.percentile(iqm(sample[picks], axis=1), (2.5, 97.5))
    return Estimated(value, Interval(float(low), float(high)), n)


def share(shares: Sequence[float]) -> Estimated:
    """``estimate`` of shares, its interval cut at 0 and 1."""
    estimated = estimate(shares)
    if (ends := estimated.interval) is None:
        return estimated
    return replace(estimated, interval=Interval(max(ends.low, 0.0), min(ends.high, 1.0)))


def rate(shares: Sequence[float], episodes: Sequence[int]) -> Estimated:
    """A share of episodes, such as success, over the runs of one camera set.

    With too few seeds, the interval is Wilson's over all their episodes, which says nothing of
    what another seed would give.
    """
    estimated = share(shares)
    if estimated.interval is not None:
        return estimated
    hits = round(sum(share * n for share, n in zip(shares, episodes, strict=True)))
    total = int(sum(episodes))
    wilson = scipy.stats.binomtest(hits, total).proportion_ci(method="wilson")
    ends = Interval(float(wilson.low), float(wilson.high), over_episodes=True)
    return Estimated(hits / total, ends, estimated.seeds)


def difference(first: Estimated, second: Estimated) -> Estimated:
    """``second`` less ``first``; without an interval where one of them has none.

    The interval is made of both (MOVER; of two of Wilson's, it is Newcombe's), so either may be
    asymmetric.
    """
    value, a, b = second.value - first.value, first.interval, second.interval
    if a is None or b is None:
        return Estimated(value)
    low = np.hypot(second.value - b.low, a.high - first.value)
    high = np.hypot(b.high - second.value, first.value - a.low)
    return Estimated(value, Interval(float(value - low), float(value + high)))
