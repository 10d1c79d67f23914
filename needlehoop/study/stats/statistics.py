"""Statistics over seeds: means and their intervals, chances to be better.

A few runs have a mean with Student's interval. From ten on they have an interquartile mean, after
Agarwal et al., "Deep RL at the Edge of the Statistical Precipice" (2021): runs are resampled within
each stratum, and 95 % intervals are the percentiles of what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binomtest, trim_mean
from scipy.stats import t as student

_RESAMPLES = 2_000
_LIMITS = (2.5, 97.5)
"""Percentiles at the ends of a 95 % interval."""

FEW = 10
"""Runs below which there is no resampling: percentiles of three runs' resamples are the runs' own
minimum and maximum, which cover three quarters and not 95 %."""

ENOUGH = 3
"""Seeds below which there is no interval: that of two would be their minimum and maximum."""

OVER_SEEDS, OVER_EPISODES = "over seeds", "over episodes"
"""What an interval is over."""


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
    """Runs in the smallest stratum."""

    @property
    def interval_or_why(self) -> Interval | str:
        """The interval, or why there is none."""
        return self.interval or no_interval(self.seeds)


def no_interval(seeds: int) -> str:
    """Why there is no interval, in words."""
    return f"{'one seed' if seeds == 1 else f'{seeds} seeds'}, no interval"


def iqm(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Mean of the middle half; of fewer than ``FEW`` values, the mean of all of them."""
    return trim_mean(values, 0.0 if values.shape[axis] < FEW else 0.25, axis=axis)


def estimate(strata: Sequence[Sequence[float]]) -> SeedEstimate:
    """The IQM over all runs.

    Args:
        strata: the runs' values, by stratum: one for a camera set's seeds; several, such as
            one for each camera set, to sum up over them. None is empty.
    """
    groups = [np.asarray(stratum, dtype=float) for stratum in strata]
    fewest = min(map(len, groups))
    value = float(iqm(np.concatenate(groups)))
    if fewest < ENOUGH:
        return SeedEstimate(value, None, fewest)
    if len(groups) == 1 and fewest < FEW:
        half = float(_half(groups[0]))
        return SeedEstimate(value, Interval(value - half, value + half), fewest)
    generator = np.random.default_rng(0)
    drawn = np.concatenate([_resample(group, generator) for group in groups], axis=1)
    return SeedEstimate(value, _percentiles(iqm(drawn, axis=1)), fewest)


def rate(shares: Sequence[float], episodes: Sequence[int]) -> SeedEstimate:
    """A share of episodes, such as success, over the runs of one camera set.

    With too few seeds, the interval is Wilson's over all their episodes, which says nothing of
    what another seed would give.

    Args:
        shares: of each run's episodes.
        episodes: of each run.
    """
    found = estimate([shares])
    if (ends := found.interval) is not None:
        return replace(found, interval=Interval(max(ends.low, 0.0), min(ends.high, 1.0)))
    hits = round(sum(share * n for share, n in zip(shares, episodes, strict=True)))
    wilson = binomtest(hits, sum(episodes)).proportion_ci(method="wilson")
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
    if fewest < ENOUGH:
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
    present = ~np.isnan(curves)
    middle, low, high = (np.full(curves.shape[1], np.nan) for _ in range(3))
    # Runs end at few different steps: each stretch with the same runs is one resampling.
    for who in np.unique(present, axis=1).T:
        here = (present == who[:, None]).all(axis=0)
        stretch = curves[who][:, here]
        if len(stretch):
            middle[here] = iqm(stretch, axis=0)
        if ENOUGH <= len(stretch) < FEW:
            half = _half(stretch)
            low[here], high[here] = middle[here] - half, middle[here] + half
        elif len(stretch) >= FEW:
            generator = np.random.default_rng(0)
            picks = generator.integers(len(stretch), size=(_RESAMPLES // 4, len(stretch)))
            drawn = iqm(stretch[picks], axis=1)
            low[here], high[here] = np.percentile(drawn, _LIMITS, axis=0)
    return middle, low, high


def _half(values: np.ndarray) -> np.ndarray:
    """Half of Student's 95 % interval of the mean of runs ``(n, ...)``."""
    n = len(values)
    return student.ppf(0.975, n - 1) * values.std(axis=0, ddof=1) / np.sqrt(n)


def _resample(values: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Runs drawn from ``(n,)`` with replacement, ``(k, n)``."""
    return values[generator.integers(len(values), size=(_RESAMPLES, len(values)))]


def _percentiles(drawn: np.ndarray) -> Interval:
    """The 95 % interval of what was drawn, ``(k,)``."""
    low, high = np.percentile(drawn, _LIMITS)
    return Interval(float(low), float(high))


def _above(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Share of pairs in which a run of ``a`` ``(k, n)`` beats one of ``b`` ``(k, m)``."""
    difference = a[:, :, None] - b[:, None, :]
    return ((np.sign(difference) + 1.0) / 2.0).mean(axis=(1, 2))
