"""What seeds say of a measured ranking: how well it repeats, and how sure an agreement with it is.

A prediction that agrees with what was measured as well as one seed does with the others is worth
a training of every set. And what it agrees with are means over few seeds, which others would move.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needlehoop.study.data.findings import Findings
from needlehoop.study.stats.agreement import Agreement, agreement
from needlehoop.study.stats.measures import Measure, by_seed
from needlehoop.study.stats.statistics import ENOUGH, iqm, percentiles, resample

ONE_SEED, OTHER_SEEDS = "one seed", "the other seeds"


@dataclass(frozen=True)
class Repeat:
    """Rankings of lists by one seed, held against those by the others, for each seed in turn."""

    lists: Mapping[frozenset[str], tuple[Agreement, ...]]
    """An agreement for each seed that all sets of a list have; lists with fewer than two such
    seeds are not there."""
    core_minutes: float | None
    """That one seed of all sets took, the mean over seeds; ``None`` if it is not on record."""


@dataclass(frozen=True)
class Spread:
    """95 % intervals over seeds: what agreement would have been with others."""

    tau: tuple[float, float] | None
    """Of the mean tau-b over lists; ``None`` where there is none."""
    regret: tuple[float, float]


def repeat(findings: Findings, measure: Measure) -> Repeat:
    """How well each seed of a study foretells the mean of its others."""
    finals = by_seed(findings, measure)
    lists = {}
    for members in map(frozenset, findings.lists.values()):
        own = [set(finals.get(name, ())) for name in members]
        shared = sorted(set.intersection(*own))
        if len(shared) > 1:
            lists[members] = tuple(_held_out(finals, members, shared, one) for one in shared)
    cost = 0.0
    for result in findings.ranked:
        known = [run.core_minutes for run in result.runs if run.core_minutes is not None]
        if len(known) < len(result.runs):
            return Repeat(lists, None)
        cost += sum(known) / len(known) if known else 0.0
    return Repeat(lists, cost)


def spread(
    lists: Sequence[Mapping[str, float]], measured: Mapping[str, Sequence[float]], seed: int = 0
) -> Spread | None:
    """Intervals of a prediction's agreement over lists, by drawing each set's seeds anew.

    Args:
        lists: a prediction's scores by set, of each list.
        measured: the values of the runs, by set.
        seed: of the drawing.

    Returns:
        ``None`` where a set has too few seeds, or has not been measured.
    """
    runs = {name: np.asarray(measured.get(name, ())) for scores in lists for name in scores}
    if not runs or min(map(len, runs.values())) < ENOUGH:
        return None
    generator = np.random.default_rng(seed)
    # A set that is in two lists has one value in both.
    drawn = {name: iqm(resample(runs[name], generator), axis=1) for name in sorted(runs)}
    taus, regrets = [], []
    for scores in lists:
        names = sorted(scores)
        a, b = (np.stack([np.asarray(of[name]) for name in names], -1) for of in (scores, drawn))
        taus.append(_taus(a, b))
        regrets.append(b.max(axis=1) - b[:, a == a.max()].mean(axis=1))
    # As in ``pooled``: a list that a draw puts on one level has no correlation there.
    known = ~np.isnan(taus)
    some = known.any(axis=0)
    means = np.where(known, taus, 0.0).sum(axis=0)[some] / known.sum(axis=0)[some]
    return Spread(percentiles(means) if some.any() else None, percentiles(np.mean(regrets, axis=0)))


def mean_known(values: Sequence[float]) -> float:
    """The mean of those that are numbers; NaN where none is."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


def _held_out(
    finals: Mapping[str, Mapping[int, float]], members: frozenset[str], seeds: list[int], one: int
) -> Agreement:
    others = [seed for seed in seeds if seed != one]
    return agreement(
        {name: finals[name][one] for name in members},
        {name: float(iqm(np.array([finals[name][seed] for seed in others]))) for name in members},
    )


def _taus(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Tau-b of scores ``a`` ``(n,)`` with each of ``b`` ``(k, n)``: ``(k,)``, NaN if undefined."""
    one = np.sign(a[:, None] - a[None, :])
    many = np.sign(b[:, :, None] - b[:, None, :])
    with np.errstate(invalid="ignore"):
        size = np.sqrt((one**2).sum() * (many**2).sum(axis=(1, 2)))
        return np.where(size > 0, (one * many).sum(axis=(1, 2)) / size, np.nan)
