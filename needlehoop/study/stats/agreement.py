"""How well a predicted order of camera sets agrees with the measured one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations

import numpy as np
from scipy.stats import rankdata

_RESAMPLES = 50_000
"""Every order of up to 8 camera sets is tried; of more, a sample of this size."""


@dataclass(frozen=True)
class Agreement:
    """Predictions held against what was measured, list by list.

    A correlation is NaN, and its p-value with it, where one side puts all on one level. Over
    several lists, those without a correlation are left out of its mean.
    """

    lists: int
    tau: float
    """Kendall's tau-b, -1 to 1; ties count for neither side. Over several lists, their mean."""
    tau_p: float
    """Two-sided permutation test: the share of orders whose |tau| is as large. Over several lists,
    each draw shuffles every list."""
    rho: float
    """Spearman's rank correlation; ties share their mean rank."""
    rho_p: float
    top_hits: int
    """Lists in which every set that was predicted best is among the best measured."""
    bottom_hits: int
    """The same of the worst."""
    regret: float
    """Best measured value less the predicted best's (their mean, if tied); in its unit. Over
    several lists, the mean."""


def agreement(*sides: tuple[Mapping[str, float], Mapping[str, float]]) -> Agreement:
    """Hold predicted scores against measured ones, list by list, and take the lists together.

    Higher is better in both. The measured ones may have more names, which do not count. A few sets
    have few orders, so a list alone seldom says that a prediction is better than chance; several
    lists together can. Draws keep each list's sets in it.
    """
    arrays = []
    for predicted, measured in sides:
        # In one order, or the draws would differ from run to run.
        names = sorted(predicted)
        both = (np.array([side[name] for name in names], float) for side in (predicted, measured))
        arrays.append((*both,))
    # Differences whose correlations are Kendall's tau-b and Spearman's rho (Daniels 1944).
    signs = [(np.sign(_differences(a)), np.sign(_differences(b))) for a, b in arrays]
    ranks = [(_differences(rankdata(a)), _differences(rankdata(b))) for a, b in arrays]
    return Agreement(
        len(arrays),
        *_correlate(signs),
        *_correlate(ranks),
        sum(bool((b[a == a.max()] == b.max()).all()) for a, b in arrays),
        sum(bool((b[a == a.min()] == b.min()).all()) for a, b in arrays),
        float(np.mean([b.max() - b[a == a.max()].mean() for a, b in arrays])),
    )


def _differences(values: np.ndarray) -> np.ndarray:
    return values[:, None] - values[None, :]


def _correlate(sides: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float]:
    """Mean correlation of matrices of differences ``(n, n)``, and its permutation p-value.

    Lists without a correlation are left out; NaN where none has one.
    """
    kept = [(a, b / size) for a, b in sides if (size := np.sqrt((a**2).sum() * (b**2).sum()))]
    if not kept:
        return math.nan, math.nan
    # Rounded, or nothing would be written as -0.00.
    value = round(float(np.mean([(a * b).sum() for a, b in kept])), 12) + 0.0
    every = len(kept) == 1 and math.factorial(len(kept[0][0])) <= _RESAMPLES
    drawn = np.mean([_drawn(*both, _orders(len(both[0]), None if every else seed))
                     for seed, both in enumerate(kept)], axis=0)  # fmt: skip
    # A hair's slack: equal correlations may differ in the last bit.
    extreme = int((np.abs(drawn) >= abs(value) - 1e-9).sum())
    # The observed order counts as one of a sample, so its p is never zero.
    observed = 0 if every else 1
    return value, (extreme + observed) / (len(drawn) + observed)


@cache
def _orders(n: int, seed: int | None) -> np.ndarray:
    """Orders of ``n`` camera sets, ``(k, n)``: random ones, or without a seed all of them."""
    if seed is None:
        return np.array([*permutations(range(n))])
    generator = np.random.default_rng(seed)
    return generator.permuted(np.tile(np.arange(n), (_RESAMPLES, 1)), axis=1)


def _drawn(a: np.ndarray, b: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """The correlation of each of the orders ``(k, n)`` of ``a`` with ``b``, ``(k,)``."""
    # In parts, for the memory's sake.
    parts = np.array_split(orders, max(1, orders.size * len(a) // 1_000_000))
    moved = (a[part[:, :, None], part[:, None, :]] for part in parts)
    return np.concatenate([np.einsum("kij,ij->k", block, b) for block in moved])
