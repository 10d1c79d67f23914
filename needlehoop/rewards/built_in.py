"""The reward of every task that pays for success alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Real

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signals


@dataclass(frozen=True)
class _Values:
    success: Real


@dataclass(frozen=True)
class Sparse:
    """Pays ``success`` once the task's fact ``goal`` is true."""

    success: float
    goal: str

    @classmethod
    def load(cls, values: Mapping[str, Any], goal: str) -> Sparse:
        """From a config's values; errors as in ``strict.structure``."""
        return cls(strict.structure(values, _Values, "reward").success, goal)

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        return {"success": self.success * getattr(signals, self.goal).double()}
