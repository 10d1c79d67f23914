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


@dataclass(frozen=True)
class Pooled:
    """Agreement over several lists, each ordered by itself.

    Lists on which a side puts all on one level have no correlation and are left out of the
    means; where that leaves none, correlations and p-values are NaN.
    """

    lists: int
    tau: float
    """Mean of the lists' tau-b."""
    tau_p: float
    """Share of draws, an order for each list, whose mean is as far from 0: two-sided."""
    rho: float
    rho_p: float
    top_hits: int
    """Lists whose best was found."""
    bottom_hits: int
    regret: float
    """Mean over the lists."""


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
    a, b = _in_one_order(predicted, measured)
    tau, tau_p = _correlate(*_signs(a, b), seed)
    rho, rho_p = _correlate(*_ranks(a, b), seed)
    return Agreement(len(a), tau, tau_p, rho, rho_p, *_hits_and_regret(a, b))


def pooled(sides: Sequence[tuple[Mapping[str, float], Mapping[str, float]]]) -> Pooled:
    """Compare several lists' scores, and take them together.

    A few sets have few orders, so that a list alone seldom says that a prediction is better
    than chance; several lists together can. What is drawn keeps each list's sets in it.

    Args:
        sides: predicted and measured scores, as for ``agreement``, of each list.

    Raises:
        ValueError: no list, or one that cannot be compared.
    """
    if not sides:
        raise ValueError("agreement: no lists")
    arrays = [_in_one_order(*both) for both in sides]
    top_hits, bottom_hits, regrets = zip(*(_hits_and_regret(*both) for both in arrays), strict=True)
    tau, tau_p = _mean_correlation([_signs(*both) for both in arrays])
    rho, rho_p = _mean_correlation([_ranks(*both) for both in arrays])
    return Pooled(
        lists=len(sides),
        tau=tau,
        tau_p=tau_p,
        rho=rho,
        rho_p=rho_p,
        top_hits=sum(top_hits),
        bottom_hits=sum(bottom_hits),
        regret=sum(regrets) / len(regrets),
    )


def _in_one_order(
    predicted: Mapping[str, float], measured: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Both sides' scores as arrays; errors as in ``agreement``."""
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
    a, b = (np.array([side[name] for name in names], float) for side in (predicted, measured))
    return a, b


def _hits_and_regret(a: np.ndarray, b: np.ndarray) -> tuple[bool, bool, float]:
    """``top_hit``, ``bottom_hit`` and ``regret`` of predicted scores ``a`` and measured ``b``."""
    chosen = a == a.max()
    return (
        bool((b[chosen] == b.max()).all()),
        bool((b[a == a.min()] == b.min()).all()),
        float(b.max() - b[chosen].mean()),
    )


def _signs(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences whose correlation is Kendall's tau-b."""
    return np.sign(_differences(a)), np.sign(_differences(b))


def _ranks(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences whose correlation is Spearman's rho (Daniels 1944)."""
    return _differences(rankdata(a)), _differences(rankdata(b))


def _correlate(a: np.ndarray, b: np.ndarray, seed: int) -> tuple[float, float]:
    """Correlation of two matrices of differences and its permutation p-value.

    NaN where one side is constant.
    """
    value = _correlation(a, b)
    if math.isnan(value):
        return math.nan, math.nan
    every = math.factorial(len(a)) <= _RESAMPLES
    orders = _every_order(len(a)) if every else _some_orders(len(a), seed)
    return value, _share(_drawn(a, b, orders), value, every)


def _mean_correlation(sides: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float]:
    """The mean over lists, and its p-value by orders drawn for each."""
    kept = [(a, b) for a, b in sides if not math.isnan(_correlation(a, b))]
    if not kept:
        return math.nan, math.nan
    value = sum(_correlation(a, b) for a, b in kept) / len(kept)
    drawn = [_drawn(a, b, _some_orders(len(a), seed)) for seed, (a, b) in enumerate(kept)]
    return value, _share(np.mean(drawn, axis=0), value, False)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    size = math.sqrt((a**2).sum() * (b**2).sum())
    return float((a * b).sum() / size) if size else math.nan


def _drawn(a: np.ndarray, b: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """The correlation of each of the orders ``(k, n)`` of ``a`` with ``b``."""
    size = math.sqrt((a**2).sum() * (b**2).sum())
    parts = np.array_split(orders, max(1, orders.size * len(a) // 1_000_000))
    moved = (a[part[:, :, None], part[:, None, :]] for part in parts)
    return np.concatenate([np.einsum("kij,ij->k", one, b) / size for one in moved])


def _share(drawn: np.ndarray, value: float, every: bool) -> float:
    """How many of the drawn are as far from 0 as ``value``; ``every``: no order is missing."""
    # A hair's slack: equal correlations may differ in the last bit.
    extreme = int((np.abs(drawn) >= abs(value) - 1e-9).sum())
    # The order found counts as one of a sample, so that its p is never zero.
    own = 0 if every else 1
    return (extreme + own) / (len(drawn) + own)


def _every_order(n: int) -> np.ndarray:
    return np.array(list(permutations(range(n))))


def _some_orders(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.permuted(np.tile(np.arange(n), (_RESAMPLES, 1)), axis=1)


def _differences(values: np.ndarray) -> np.ndarray:
    return values[:, None] - values[None, :]
