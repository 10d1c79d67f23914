"""A sharp expert, and one that can be imitated."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.robot.geometry import aside
from needlehoop.scene.signals import Signals
from needlehoop.tasks.scripted import Script

_HOVER = 0.012
"""Height above the target at which the tool crosses the phantom, m."""

_BESIDE = 0.003
"""Distance aside of the target at which the sharp expert goes down, m."""

_FREE, _SLOPE = 0.003, 1.2
"""The funnel above the target: its radius at the bottom, m, and its slope."""

_PRESS = 0.001
"""How far below the target the tool is sent, m: the button stops it."""


class Expert(Script):
    """Across the phantom, then down."""

    def __call__(self, s: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        away = s.target - s.tool_midpoint
        away[:, 2] += self._height(aside(away))
        # Neither the turn about the instrument nor the jaws matter.
        none = torch.zeros_like(away[:, 0])
        return self.action(away, none, none)

    def _height(self, aside: Tensor) -> Tensor:
        """Height to go for above the target ``(n,)``, m, at a distance ``aside`` of it, m."""
        return torch.where(aside < _BESIDE, 0.0, _HOVER)


class Smooth(Expert):
    """The expert with a ramp for its switch: actions change little where signals do."""

    def _height(self, aside: Tensor) -> Tensor:
        """Down a funnel, and onto the button."""
        return (_SLOPE * (aside - _FREE)).clamp(0.0, _HOVER) - _PRESS
