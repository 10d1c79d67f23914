"""Scripted controllers that reach the target: a sharp one, and one that can be imitated.

They see signals and act through the agent's own actions, so what they do an agent can.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.scene.signals import Signals
from needlehoop.tasks.reach.layout import ReachLayout, ReachRules

GAIN = 0.4
"""Share of the remaining error that an action asks for; the servos lag behind."""

HOVER = 0.012
"""Height above the target at which the tool crosses the phantom, m."""

_BESIDE = 0.003
"""Distance aside of the target at which the sharp expert goes down, m."""

# Who learns from images of 64 px knows places to 2 or 3 mm and does what the expert would do on
# average over what may be there. So the smooth expert has a ramp for the switch; and it goes for
# a point below the target, where the button stops the jaws.

_FREE, _SLOPE = 0.003, 1.2
"""The funnel above the target: its radius at the bottom, m, and its slope."""

_PRESS = 0.001
"""How far below the target the tool is sent, m."""


@dataclass(frozen=True)
class Script:
    """A controller for ``control=tip``, without memory: across the phantom, then down.

    Args:
        layout: sizes.
        episode: action scales.
    """

    layout: ReachLayout
    episode: ReachRules

    def __post_init__(self) -> None:
        if self.episode.control != "tip":
            raise ValueError(
                f"episode.control: {self.episode.control!r}; the expert drives control=tip"
            )

    def __call__(self, signals: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        away = signals.target - signals.tool_midpoint
        aside = torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2)
        away[:, 2] += self._height(aside)
        translation = (GAIN * away / self.episode.translation).clamp(-1, 1)
        # Neither the turn about the instrument nor the jaws matter.
        return torch.cat((translation, torch.zeros_like(away[:, :2])), -1)

    def _height(self, aside: Tensor) -> Tensor:
        """Height to go for, m above the target, so far aside of it ``(n,)``, m."""
        return torch.where(aside < _BESIDE, 0.0, HOVER)


class Smooth(Script):
    """The expert with a ramp for its switch: actions change little where signals do."""

    def _height(self, aside: Tensor) -> Tensor:
        """Down a funnel, and onto the button."""
        return (_SLOPE * (aside - _FREE)).clamp(0.0, HOVER) - _PRESS


def expert(layout: ReachLayout, episode: ReachRules) -> Script:
    """The controller that reaches the target."""
    return Script(layout, episode)


def smooth(layout: ReachLayout, episode: ReachRules) -> Smooth:
    """The controller that reaches the target and can be imitated."""
    return Smooth(layout, episode)
