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

    n: int
    """Camera sets, over all lists."""
    lists: int
    tau: float
    """Kendall's tau-b, -1 to 1; ties count for neither side. Over several lists, their mean."""
    tau_p: float
    """Share of the orders that agree or disagree as strongly: two-sided permutation test. Over
    several lists, of draws of an order for each list."""
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

    @property
    def top_hit(self) -> bool:
        return self.top_hits == self.lists

    @property
    def bottom_hit(self) -> bool:
        return self.bottom_hits == self.lists


def agreement(predicted: Mapping[str, float], measured: Mapping[str, float]) -> Agreement:
    """Compare two mappings of scores over the same names; higher is better in both.

    Raises:
        ValueError: other names on one side.
    """
    return pooled([(predicted, measured)])


def pooled(sides: Sequence[tuple[Mapping[str, float], Mapping[str, float]]]) -> Agreement:
    """Compare several lists' scores, and take them together.

    A few sets have few orders, so a list alone seldom says that a prediction is better than
    chance; several lists together can. Draws keep each list's sets in it.

    Raises:
        ValueError: other names on one side of a list.
    """
    arrays = [_in_one_order(*both) for both in sides]
    # Differences whose correlations are Kendall's tau-b and Spearman's rho (Daniels 1944).
    signs = [(np.sign(_differences(a)), np.sign(_differences(b))) for a, b in arrays]
    ranks = [(_differences(rankdata(a)), _differences(rankdata(b))) for a, b in arrays]
    top, bottom, regrets = zip(*(_hits_and_regret(*both) for both in arrays), strict=True)
    return Agreement(
        sum(len(a) for a, _ in arrays),
        len(arrays),
        *_correlate(signs),
        *_correlate(ranks),
        sum(top),
        sum(bottom),
        sum(regrets) / len(arrays),
    )


def _in_one_order(
    predicted: Mapping[str, float], measured: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Both sides' scores as arrays ``(n,)``; errors as in ``agreement``."""
    if odd := sorted(set(predicted) ^ set(measured)):
        raise ValueError(f"agreement: {', '.join(odd)} on one side only; both must rank the same")
    names = sorted(predicted)
    a, b = (np.array([side[name] for name in names], float) for side in (predicted, measured))
    return a, b


def _hits_and_regret(a: np.ndarray, b: np.ndarray) -> tuple[bool, bool, float]:
    """Whether best and worst were found, and the regret; ``a`` predicted, ``b`` measured."""
    chosen = a == a.max()
    return (
        bool((b[chosen] == b.max()).all()),
        bool((b[a == a.min()] == b.min()).all()),
        float(b.max() - b[chosen].mean()),
    )


def _differences(values: np.ndarray) -> np.ndarray:
    return values[:, None] - values[None, :]


def _correlate(sides: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float]:
    """Mean correlation of matrices of differences ``(n, n)``, and its permutation p-value.

    Lists without a correlation are left out; NaN where none has one.
    """
    kept = [both for both in sides if _size(*both) > 0]
    if not kept:
        return math.nan, math.nan
    value = sum(float((a * b).sum() / _size(a, b)) for a, b in kept) / len(kept)
    sizes = [len(a) for a, _ in kept]
    every = len(kept) == 1 and math.factorial(sizes[0]) <= _RESAMPLES
    if every:
        orders = [np.array([*permutations(range(sizes[0]))])]
    else:
        orders = [_some_orders(n, seed) for seed, n in enumerate(sizes)]
    drawn = np.mean([_drawn(*both, own) for both, own in zip(kept, orders, strict=True)], axis=0)
    # A hair's slack: equal correlations may differ in the last bit.
    extreme = int((np.abs(drawn) >= abs(value) - 1e-9).sum())
    # The order found counts as one of a sample, so its p is never zero.
    own = 0 if every else 1
    return value, (extreme + own) / (len(drawn) + own)


def _size(a: np.ndarray, b: np.ndarray) -> float:
    return math.sqrt((a**2).sum() * (b**2).sum())


@cache
def _some_orders(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.permuted(np.tile(np.arange(n), (_RESAMPLES, 1)), axis=1)


def _drawn(a: np.ndarray, b: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """The correlation of each of the orders ``(k, n)`` of ``a`` with ``b``."""
    parts = np.array_split(orders, max(1, orders.size * len(a) // 1_000_000))
    moved = (a[part[:, :, None], part[:, None, :]] for part in parts)
    return np.concatenate([np.einsum("kij,ij->k", one, b) / _size(a, b) for one in moved])
