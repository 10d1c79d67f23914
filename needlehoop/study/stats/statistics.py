"""Statistics over seeds: means and their intervals, chances to be better.

A few runs have a mean with Student's interval. From ten on they have an interquartile mean, after
Agarwal et al., "Deep RL at the Edge of the Statistical Precipice" (2021): runs are resampled, and
95 % intervals are the percentiles of what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

# Its ``stats`` are imported at their first use: a table of files alone does not wait for them.
import scipy

_RESAMPLES = 2_000

FEW = 10
"""Runs below which there is no resampling: percentiles of three runs' resamples are the runs' own
minimum and maximum, which cover three quarters and not 95 %."""

ENOUGH = 3
"""Seeds below which there is no interval: that of two would be their minimum and maximum."""

ENOUGH_TO_COMPARE = 5
"""Runs a side below which a comparison has no interval. Of three that all beat three, every
resample says so, while chance alone does it in one case of ten; of five in one of 126."""

OVER_SEEDS, OVER_EPISODES = "over seeds", "over episodes"


@dataclass(frozen=True)
class Interval:
    """The ends of a 95 % interval."""

    low: float
    high: float
    over: str = OVER_SEEDS
    """What varies within it: seeds, or the episodes of too few seeds."""


@dataclass(frozen=True)
class Estimated:
    """A value, and where it is known how sure it is."""

    value: float
    interval: Interval | None = None


@dataclass(frozen=True)
class SeedEstimate(Estimated):
    """A value over seeds; without an interval where they are too few to tell."""

    seeds: int = 1
    """Runs that it is of; of a comparison, those of the side with fewer."""

    @property
    def interval_or_why(self) -> Interval | str:
        return self.interval or no_interval(self.seeds)


def no_interval(seeds: int) -> str:
    """Why there is no interval, in words."""
    return f"{'one seed' if seeds == 1 else f'{seeds} seeds'}, no interval"


def iqm(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Mean of the middle half; of fewer than ``FEW`` values, the mean of all of them."""
    return scipy.stats.trim_mean(values, 0.0 if values.shape[axis] < FEW else 0.25, axis=axis)


def estimate(values: Sequence[float] | np.ndarray) -> SeedEstimate:
    """The IQM over runs ``(n,)``; of fewer than ``FEW`` their mean, with Student's interval."""
    own = np.asarray(values, dtype=float)
    n, value = len(own), float(iqm(own))
    if n < ENOUGH:
        return SeedEstimate(value, None, n)
    if n < FEW:
        half = float(scipy.stats.t.ppf(0.975, n - 1) * own.std(ddof=1) / np.sqrt(n))
        return SeedEstimate(value, Interval(value - half, value + half), n)
    drawn = _resample(own, np.random.default_rng(0))
    return SeedEstimate(value, _percentiles(iqm(drawn, axis=1)), n)


def rate(shares: Sequence[float], episodes: Sequence[int]) -> SeedEstimate:
    """A share of episodes, such as success, over the runs of one camera set.

    With too few seeds, the interval is Wilson's over all their episodes, which says nothing of
    what another seed would give.
    """
    found = estimate(shares)
    if (ends := found.interval) is not None:
        return replace(found, interval=Interval(max(ends.low, 0.0), min(ends.high, 1.0)))
    hits = round(sum(share * n for share, n in zip(shares, episodes, strict=True)))
    wilson = scipy.stats.binomtest(hits, sum(episodes)).proportion_ci(method="wilson")
    interval = Interval(float(wilson.low), float(wilson.high), OVER_EPISODES)
    return SeedEstimate(hits / sum(episodes), interval, found.seeds)


def difference(first: SeedEstimate, second: SeedEstimate) -> Interval | None:
    """The 95 % interval of ``second`` less ``first``; ``None`` where one of them has none.

    It is made of both intervals (MOVER; of two of Wilson's, it is Newcombe's), so neither has to be
    as far to one side of its value as to the other.
    """
    a, b = first.interval, second.interval
    if a is None or b is None:
        return None
    value = second.value - first.value
    low = np.hypot(second.value - b.low, a.high - first.value)
    high = np.hypot(b.high - second.value, first.value - a.low)
    over = a.over if a.over == b.over else OVER_EPISODES
    return Interval(float(value - low), float(value + high), over)


def improvement(better: Sequence[float], worse: Sequence[float]) -> SeedEstimate:
    """The chance that a run of one camera set ends above a run of another; a tie is half."""
    a, b = np.asarray(better, dtype=float), np.asarray(worse, dtype=float)
    value = float(_above(a[None], b[None])[0])
    fewest = min(len(a), len(b))
    if fewest < ENOUGH_TO_COMPARE:
        return SeedEstimate(value, None, fewest)
    generator = np.random.default_rng(0)
    drawn = _above(_resample(a, generator), _resample(b, generator))
    return SeedEstimate(value, _percentiles(drawn), fewest)


def band(curves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """IQM and interval at every point of curves; whole runs are drawn, so points hang together.

    Args:
        curves: ``(seeds, points)``; NaN where a run has not come so far.

    Returns:
        Middle, low and high, ``(points,)`` each; low and high are NaN where there are fewer
        than three runs.
    """
    middle, low, high = np.full((3, curves.shape[1]), np.nan)
    for point, column in enumerate(curves.T):
        known = column[~np.isnan(column)]
        if not len(known):
            continue
        found = estimate(known)
        middle[point] = found.value
        if found.interval is not None:
            low[point], high[point] = found.interval.low, found.interval.high
    return middle, low, high


def _resample(values: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Runs drawn from ``(n,)`` with replacement, ``(k, n)``."""
    return values[generator.integers(len(values), size=(_RESAMPLES, len(values)))]


def _percentiles(drawn: np.ndarray) -> Interval:
    """The 95 % interval of what was drawn, ``(k,)``."""
    low, high = np.percentile(drawn, (2.5, 97.5))
    return Interval(float(low), float(high))


def _above(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Share of pairs in which a run of ``a`` ``(k, n)`` beats one of ``b`` ``(k, m)``."""
    difference = a[:, :, None] - b[:, None, :]
    return ((np.sign(difference) + 1.0) / 2.0).mean(axis=(1, 2))
