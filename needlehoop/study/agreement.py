"""How well a predicted order of camera combinations agrees with the measured one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.stats import rankdata

_RESAMPLES = 50_000
"""Every order of up to 8 combinations is tried; of more, a sample of this size."""


@dataclass(frozen=True)
class Agreement:
    """A prediction held against what was measured, over the same ``n`` combinations.

    A correlation is NaN, and its p-value with it, where one side puts all on one level.
    """

    n: int
    tau: float
    """Kendall's tau-b, -1 to 1; ties count for neither side."""
    tau_p: float
    """Share of the orders that agree or disagree as strongly: two-sided permutation test."""
    rho: float
    """Spearman's rank correlation; ties share their mean rank."""
    rho_p: float
    top_hit: bool
    """Whether every combination that was predicted best is among the best measured."""
    bottom_hit: bool
    """The same of the worst."""
    regret: float
    """Best measured value less the predicted best's (their mean, if tied); in its unit."""


def scores(order: Sequence[str]) -> dict[str, float]:
    """An order, best first, as a score by name: higher is better.

    Raises:
        ValueError: a name that comes twice.
    """
    if len(set(order)) < len(order):
        twice = sorted({name for name in order if list(order).count(name) > 1})
        raise ValueError(f"order: {', '.join(twice)} more than once")
    return {name: float(len(order) - place) for place, name in enumerate(order)}


def agreement(
    predicted: Mapping[str, float], measured: Mapping[str, float], seed: int = 0
) -> Agreement:
    """Compare two sets of scores over the same names; higher is better in both.

    Args:
        predicted: such as ``scores`` of a ranking; equal scores are ties.
        measured: such as final returns.
        seed: of the permutations, where there are too many to try them all.

    Raises:
        ValueError: other names on one side, fewer than two, or a value that is not finite.
    """
    if set(predicted) != set(measured):
        odd = ", ".join(sorted(set(predicted) ^ set(measured)))
        raise ValueError(f"agreement: {odd} on one side only; both must rank the same")
    if len(predicted) < 2:
        raise ValueError(f"agreement: {len(predicted)} combinations; an order takes two")
    for side, values in (("predicted", predicted), ("measured", measured)):
        for name, value in values.items():
            if not math.isfinite(value):
                raise ValueError(f"agreement: {side} {name}: {value} is not finite")
    names = sorted(predicted)
    a = np.array([predicted[name] for name in names], dtype=float)
    b = np.array([measured[name] for name in names], dtype=float)
    tau, tau_p = _correlate(np.sign(_differences(a)), np.sign(_differences(b)), seed)
    rho, rho_p = _correlate(_differences(rankdata(a)), _differences(rankdata(b)), seed)
    chosen = a == a.max()
    return Agreement(
        n=len(names),
        tau=tau,
        tau_p=tau_p,
        rho=rho,
        rho_p=rho_p,
        top_hit=bool((b[chosen] == b.max()).all()),
        bottom_hit=bool((b[a == a.min()] == b.min()).all()),
        regret=float(b.max() - b[chosen].mean()),
    )


def _correlate(a: np.ndarray, b: np.ndarray, seed: int) -> tuple[float, float]:
    """Correlation of two square matrices of differences, and its permutation p-value.

    With the differences' signs it is Kendall's tau-b, with differences of ranks Spearman's
    rho (Daniels 1944). NaN where one side is constant.
    """
    size = math.sqrt((a**2).sum() * (b**2).sum())
    if size == 0:
        return math.nan, math.nan
    value = float((a * b).sum() / size)
    n = len(a)
    every = math.factorial(n) <= _RESAMPLES
    orders = _every_order(n) if every else _some_orders(n, seed)
    extreme = 0
    for part in np.array_split(orders, max(1, orders.size * n // 1_000_000)):
        moved = a[part[:, :, None], part[:, None, :]]
        drawn = np.einsum("kij,ij->k", moved, b) / size
        # A hair's slack: equal correlations may differ in the last bit.
        extreme += int((np.abs(drawn) >= abs(value) - 1e-9).sum())
    # The order found counts as one of a sample, so that its p is never zero.
    own = 0 if every else 1
    return value, (extreme + own) / (len(orders) + own)


def _every_order(n: int) -> np.ndarray:
    return np.array(list(permutations(range(n))))


def _some_orders(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.permuted(np.tile(np.arange(n), (_RESAMPLES, 1)), axis=1)


def _differences(values: np.ndarray) -> np.ndarray:
    return values[:, None] - values[None, :]
