"""What an axis of disturbance is, and what an episode draws for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

EPISODE, VIEW, THING = "episode", "view", "thing"
"""What an axis is drawn for: once, for each view by itself, for each thing in the scene."""


class Drawn(NamedTuple):
    """What episodes drew for an axis; a dimension for views or things follows ``n``.

    ``amount`` ``(n, …, size)``: how strong, in the axis's unit. ``free`` ``(n, …, free)``: numbers
    in [0, 1) that say where, when or which.
    """

    amount: np.ndarray
    free: np.ndarray

    def __getitem__(self, rows: Any) -> Drawn:  # type: ignore[override]
        """Some rows."""
        return Drawn(self.amount[rows], self.free[rows])


class When(NamedTuple):
    """Steps that the episodes have taken ``(n,)``, and the share of their time that is over."""

    steps: np.ndarray
    share: np.ndarray


@dataclass(frozen=True)
class Axis:
    """One thing that goes wrong.

    An episode draws ``size`` numbers, uniform in [-amount, amount] if ``signed``, else in [0,
    amount]; the config gives the amount.
    """

    meaning: str
    unit: str
    most: float
    """Largest amount that makes sense."""
    apply: Callable[..., Any]
    """Pure and batched; what it takes and gives is said where the axis is defined."""
    signed: bool = False
    size: int = 1
    free: int = 0
    per: str = EPISODE
    whole: bool = False
    """Whether amounts are counts; an episode then draws one of 0, …, amount."""

    def drawn(self, numbers: np.ndarray, amounts: np.ndarray) -> Drawn:
        """What becomes of uniform numbers ``(n, …, size + free)`` at ``amounts`` ``(n,)``."""
        first, free = numbers[..., : self.size], numbers[..., self.size :]
        scale = amounts.reshape(-1, *[1] * (numbers.ndim - 1))
        if self.whole:
            return Drawn(np.floor(first * (scale + 1.0)), free)
        return Drawn((2.0 * first - 1.0 if self.signed else first) * scale, free)
