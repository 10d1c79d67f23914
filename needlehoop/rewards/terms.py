"""What a reward is, what its terms add up to, and the reward that pays for success alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signals


class Reward(Protocol):
    """Named terms of a potential; the same names at every call."""

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name."""
        ...


class RewardError(RuntimeError):
    """A reward that can't be used at some state that training reached."""


@dataclass(frozen=True)
class Sparse:
    """Pays ``success`` once the task's fact ``goal`` is true."""

    success: float
    goal: str

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        return {"success": self.success * getattr(signals, self.goal).double()}


def potential(terms: Mapping[str, Tensor]) -> Tensor:
    """Sum of the terms, in their order, ``(n,)``."""
    return reduce(torch.add, terms.values())


def check_finite(terms: Mapping[str, Tensor], origin: str) -> None:
    """``RewardError`` if a term ``(n,)`` is not finite.

    The agent would learn from any number put in its place.
    """
    for name, term in terms.items():
        finite = torch.isfinite(term)
        if not bool(finite.all()):
            bad = (~finite).nonzero().flatten().tolist()
            raise RewardError(
                f"reward: term {name!r} of {origin} is not finite in environments {bad}"
            )
