"""Success and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

from needlehoop.config.strict import Real

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signals


@dataclass(frozen=True)
class Sparse:
    """Pays ``success`` once the needle is through the hoop."""

    success: Real

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        return {"success": self.success * signals.threaded.double()}
