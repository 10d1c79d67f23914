"""Errors of readings, their files, and the score of a camera set.

The score is the mean over phases of ``1 - e / e0``. ``e`` is the error in mm of the quantity that
the phase needs. ``e0`` is that error of a constant answer, the mean of the phase's training frames.
A score of 1 means no error; 0 means no better than the constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from needlehoop.probe.frames import KINDS, Frames, Quantities
from needlehoop.runs.files import SIGNALS
from needlehoop.study.stats.statistics import Estimated, Interval

TRUTH, CONSTANT = SIGNALS, "constant"
"""Baselines beside the camera sets: the true state read by the same trunk, and a constant."""

_RESAMPLES = 2_000


def errors(
    targets: Quantities, frames: Frames, points: Tensor, fact: Tensor, episodes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of what was read off held-out frames, as ``Frames`` has it.

    Means ``(episodes, phases, quantities)``, NaN where an episode has no such phase; and how many
    frames each is over, ``(episodes, phases)``.
    """
    off = (points - frames.points).double()
    by_name = dict(zip(targets.points, off.unbind(1), strict=True))
    wrong = [*by_name.values(), *(by_name[to] - by_name[of] for of, to in targets.gaps.values())]
    columns = [offset.norm(dim=-1) for offset in wrong]
    columns.append((fact != frames.fact).double())
    values = np.stack([column.numpy() for column in columns], -1)
    total = np.zeros((episodes, len(targets.phases), len(targets.names)))
    count = np.zeros((episodes, len(targets.phases)), dtype=int)
    where = (frames.episode.numpy(), frames.phase.numpy())
    np.add.at(total, where, values)
    np.add.at(count, where, 1)
    with np.errstate(invalid="ignore"):
        return total / count[..., None], count


def constant(targets: Quantities, learnt: Frames, frames: Frames) -> tuple[Tensor, Tensor]:
    """The best constant ``points`` and ``fact`` for ``frames``.

    Points: their mean over the phase's training frames. The fact: as in most training frames.
    ``ValueError``: a phase that no training frame shows.
    """
    points = torch.empty_like(frames.points)
    for phase, name in enumerate(targets.phases):
        known = learnt.points[learnt.phase == phase]
        if not len(known):
            raise ValueError(f"episodes.train: none comes to the phase {name}; take more")
        points[frames.phase == phase] = known.mean(0)
    commonest = learnt.fact.float().mean() > 0.5
    return points, commonest.expand(len(frames))


def _columns(targets: Quantities) -> list[str]:
    """Columns of a file of errors: who acted, how many frames there are, and the mean errors."""
    frames = [f"{phase}_frames" for phase in targets.phases]
    means = [f"{phase}_{name}" for phase in targets.phases for name in targets.names]
    return ["episode", "kind", *frames, *means]


def save(path: Path, targets: Quantities, means: np.ndarray, frames: np.ndarray) -> None:
    """Write a camera set's errors, as ``errors`` returns them, as a table of episodes."""
    rows = [
        (episode, KINDS[episode % len(KINDS)], *counts, *(f"{value:.4g}" for value in values.flat))
        for episode, (values, counts) in enumerate(zip(means, frames, strict=True))
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows, columns=_columns(targets)).replace("nan", "").to_csv(path, index=False)


def load(folder: Path, targets: Quantities) -> ProbeResults:
    """The results in a folder: ``seed<k>/<cameras>.csv``; ``ValueError``: of another task."""
    seeds = sorted(folder.glob("seed*"), key=lambda place: int(place.name.removeprefix("seed")))
    means = {}
    for file in sorted(seeds[0].glob("*.csv")):
        tables = []
        for seed in seeds:
            table = pd.read_csv(seed / file.name)
            if list(table.columns) != _columns(targets):
                raise ValueError(f"{seed / file.name} is not of a probe of {targets.task}")
            shape = len(table), len(targets.phases), len(targets.names)
            tables.append(table.iloc[:, 2 + len(targets.phases) :].to_numpy(float).reshape(shape))
        means[file.stem] = np.stack(tables)
    return ProbeResults(targets, means)


class ProbeResults:
    """Errors and scores of camera sets and baselines, by name.

    ``means``: ``(seeds, episodes, phases, quantities)``, NaN where an episode has no such phase.
    """

    def __init__(self, targets: Quantities, means: Mapping[str, np.ndarray]):
        seeds, episodes = means[CONSTANT].shape[:2]
        self.targets, self.seeds = targets, seeds
        # How often each episode counts: once; then in each of the samples.
        evenly, generator = np.full(episodes, 1 / episodes), np.random.default_rng(0)
        drawn = generator.multinomial(episodes, evenly, size=(seeds, _RESAMPLES))
        counts = np.concatenate((np.ones((seeds, 1, episodes)), drawn), 1)
        self._errors = {name: _weighted(values, counts) for name, values in means.items()}
        needed = [targets.names.index(targets.needed[phase]) for phase in targets.phases]
        of_phases = {
            name: values[..., range(len(needed)), needed] for name, values in self._errors.items()
        }
        self._scores = {
            name: (1 - values / of_phases[CONSTANT]).mean(-1) for name, values in of_phases.items()
        }
        cameras = [name for name in means if name not in (TRUTH, CONSTANT)]
        self.places = places({name: self.score(name) for name in cameras})
        """Of camera sets: the best and the worst place that the intervals leave open."""

        self.ranked = sorted(self.places, key=lambda name: (-self.score(name).value, name))
        """Camera sets, the best score first; without the baselines."""

    def score(self, name: str) -> Estimated:
        """Mean over seeds, and its 95 % interval over held-out episodes."""
        return _mean(self._scores[name])

    def scores_by_seed(self, name: str) -> list[float]:
        """Without intervals."""
        return self._scores[name][:, 0].tolist()

    def error(self, name: str, phase: str, quantity: str) -> Estimated:
        """Mean error in mm (of the fact: a share), as ``score``."""
        at = self.targets.phases.index(phase), self.targets.names.index(quantity)
        return _mean(self._errors[name][..., *at])


def places(scores: Mapping[str, Estimated]) -> dict[str, tuple[int, int]]:
    """The best and the worst place that each camera set may have, counted from 1.

    One is before another only where its whole interval is above the other's. Two whose
    intervals overlap always share a place.
    """
    intervals = {name: score.interval for name, score in scores.items() if score.interval}
    return {
        name: (
            1 + sum(other.low > interval.high for other in intervals.values()),
            len(intervals) - sum(other.high < interval.low for other in intervals.values()),
        )
        for name, interval in intervals.items()
    }


def _weighted(means: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Means over the episodes that have a value, ``(seeds, samples, phases, quantities)``.

    ``counts``: how often each episode counts, ``(seeds, samples, episodes)``.
    """
    has = ~np.isnan(means)
    pairs = "ske,sepq->skpq"
    # A sample may have none of them.
    with np.errstate(invalid="ignore"):
        return np.einsum(pairs, counts, np.where(has, means, 0.0), optimize=True) / np.einsum(
            pairs, counts, has.astype(float), optimize=True
        )


def _mean(samples: np.ndarray) -> Estimated:
    """Mean over seeds and its ends, of ``(seeds, samples)``; the first has all episodes."""
    over_seeds = samples.mean(0)
    low, high = np.nanpercentile(over_seeds[1:], (2.5, 97.5))
    return Estimated(float(over_seeds[0]), Interval(float(low), float(high)))
