"""What a reward is, and what its terms add up to."""

from __future__ import annotations

from collections.abc import Mapping
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


def potential(terms: Mapping[str, Tensor]) -> Tensor:
    """Sum of the terms, in their order, ``(n,)``."""
    return reduce(torch.add, terms.values())
