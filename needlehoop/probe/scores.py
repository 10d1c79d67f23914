"""Errors of readings, and the score of a camera set.

The score is the mean over phases of ``1 - e / e0``. ``e`` is the error in mm of the quantity that
the phase needs. ``e0`` is that error of a constant answer, the mean of the phase's training frames.
A score of 1 means no error; 0 means no better than the constant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from needlehoop.probe.frames import Frames
from needlehoop.probe.quantities import Quantities
from needlehoop.probe.reader import Reading

Columns = Sequence[tuple[np.ndarray, np.ndarray | None]]

_RESAMPLES = 2_000
_LIMITS = (2.5, 97.5)
"""Percentiles of a 95 % interval."""


@dataclass(frozen=True)
class Errors:
    """Mean errors of held-out episodes.

    ``mean`` ``(episodes, phases, quantities)``, NaN where an episode has no such phase; ``frames``
    ``(episodes, phases)``, how many each mean is over.
    """

    mean: np.ndarray
    frames: np.ndarray


@dataclass(frozen=True)
class Interval:
    """A value and its 95 % interval over held-out episodes."""

    value: float
    low: float
    high: float


def errors(asked: Quantities, frames: Frames, reading: Reading, episodes: int) -> Errors:
    """Errors of a reading of held-out frames, episode by episode."""
    off = (reading.points - frames.points).double()
    by_name = dict(zip(asked.points, off.unbind(1), strict=True))
    wrong = [*by_name.values(), *(by_name[to] - by_name[of] for of, to in asked.gaps.values())]
    columns = [one.norm(dim=-1) for one in wrong]
    columns.append((reading.fact != frames.fact).double())
    values = np.stack([column.numpy() for column in columns], -1)
    total = np.zeros((episodes, len(asked.phases), len(asked.names)))
    count = np.zeros((episodes, len(asked.phases)), dtype=int)
    where = (frames.episode.numpy(), frames.phase.numpy())
    np.add.at(total, where, values)
    np.add.at(count, where, 1)
    with np.errstate(invalid="ignore"):
        return Errors(total / count[..., None], count)


def constant(asked: Quantities, learnt: Frames, frames: Frames) -> Reading:
    """The best constant answer for ``frames``.

    Of places the mean of the phase's training frames; the fact as most training frames are.

    Raises:
        ValueError: a phase that no training frame shows.
    """
    points = torch.empty_like(frames.points)
    for phase, name in enumerate(asked.phases):
        known = learnt.points[learnt.phase == phase]
        if not len(known):
            raise ValueError(f"episodes.train: none comes to the phase {name}; take more")
        points[frames.phase == phase] = known.mean(0)
    commonest = learnt.fact.float().mean() > 0.5
    return Reading(points, commonest.expand(len(frames)))


def score(asked: Quantities, found: Sequence[Errors], constants: Sequence[Errors]) -> Interval:
    """The score of one camera set, as the module says; mean over the probe's seeds.

    Args:
        asked: what each phase needs.
        found: of the camera set, seed by seed.
        constants: of the constant, likewise.
    """
    return _interval(
        [
            [
                (own.mean[:, p, q], blind.mean[:, p, q])
                for p, q in enumerate(
                    asked.names.index(asked.needed[name]) for name in asked.phases
                )
            ]
            for own, blind in zip(found, constants, strict=True)
        ]
    )


def error(asked: Quantities, found: Sequence[Errors], phase: str, quantity: str) -> Interval:
    """Mean error over episodes, in mm (of the fact: a share); mean over the probe's seeds."""
    p, q = asked.phases.index(phase), asked.names.index(quantity)
    return _interval([[(own.mean[:, p, q], None)] for own in found])


def places(scores: Mapping[str, Interval]) -> dict[str, tuple[int, int]]:
    """The best and the worst place that each camera set may have, counted from 1.

    One is before another only where its whole interval is above the other's. Two whose
    intervals overlap always share a place.
    """
    n = len(scores)
    return {
        name: (
            1 + sum(other.low > own.high for other in scores.values()),
            n - sum(other.high < own.low for other in scores.values()),
        )
        for name, own in scores.items()
    }


def _value(columns: Columns, weights: np.ndarray) -> np.ndarray:
    """One seed's mean error, or mean score over the phases, by sample ``(k,)``.

    Args:
        columns: for each phase, errors by episode and those of the constant. With ``None`` for
            the latter, the mean error itself is wanted.
        weights: how often each episode counts ``(k, episodes)``.
    """
    parts = []
    for own, blind in columns:
        value = _mean(own, weights)
        parts.append(value if blind is None else 1.0 - value / _mean(blind, weights))
    return np.mean(parts, axis=0)


def _mean(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted means ``(k,)`` over the episodes that have a value."""
    has = ~np.isnan(values)
    # A sample may have none of them.
    with np.errstate(invalid="ignore"):
        return weights[:, has] @ values[has] / weights[:, has].sum(1)


def _interval(seeds: Sequence[Columns]) -> Interval:
    """Mean over seeds; episodes are resampled within each. Columns as in ``_value``."""
    generator = np.random.default_rng(0)
    value, drawn = 0.0, np.zeros(_RESAMPLES)
    for one in seeds:
        n = len(one[0][0])
        value += float(_value(one, np.ones((1, n)))[0]) / len(seeds)
        weights = generator.multinomial(n, np.full(n, 1.0 / n), size=_RESAMPLES)
        drawn += _value(one, weights.astype(float)) / len(seeds)
    low, high = np.nanpercentile(drawn, _LIMITS)
    return Interval(value, float(low), float(high))
