"""The hand-written reward of reach."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.config.strict import Amount, Positive, Real
from needlehoop.robot.geometry import distance
from needlehoop.scene.signals import Signals


@dataclass(frozen=True)
class Human:
    """Approach, be there, stay; values in ``conf/reward/human``.

    The term ``reach`` is ``exp(-max(d - tolerance, 0) / scale)`` of its weight, where ``d`` is
    the distance to the target, m. All places that count as near the target pay the same, and
    ``stay`` is worth more than the whole of ``time``: nothing pays more than success.
    """

    tolerance: Amount
    """Distance from which on ``reach`` falls, m."""
    scale: Positive
    """Distance over which it falls to a third, m."""
    reach: Real
    near: Real
    stay: Real
    time: Real

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        s = signals
        beyond = (distance(s.tool_midpoint, s.target) - self.tolerance).clamp(min=0.0)
        return {
            "reach": self.reach * torch.exp(-beyond / self.scale),
            "near": self.near * s.near.double(),
            "stay": self.stay * s.stayed.double(),
            "time": -self.time * s.elapsed,
        }
