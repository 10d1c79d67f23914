"""A scripted expert that can be imitated from images: nothing it does hangs by a millimetre."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.layout import Layout
from needlehoop.scene.signals import Signals
from needlehoop.task.episode import Episode
from needlehoop.task.expert import GAIN, HOVER, STANDOFF, Script

_NEAR, _FAR = 0.005, 0.008
"""Distances from the pickup point at which the jaws are asked to be shut and open, m. Images of
64 px give a place to 2 or 3 mm: an action that switches within less cannot be learnt from them."""

_FREE = 0.003
"""Distance aside of the pickup point within which nothing keeps the jaws above it, m."""

_SLOPE = 1.5
"""Height above the pickup point per distance aside beyond that."""

_AIMED, _ASTRAY = 0.25, 0.75
"""Distance of the tip aside of the hoop's axis, in radii of the opening, at which it is sent all
the way through, and held before the hoop."""


@dataclass(frozen=True)
class Smooth(Script):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def _approach(self, s: Signals, misaligned: Tensor) -> Tensor:
        """Down a funnel: the nearer above the pickup point, the lower."""
        away = s.pickup_point - s.tool_midpoint
        aside = torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2)
        away[:, 2] += (_SLOPE * (aside - _FREE)).clamp(0.0, HOVER)
        return away

    def _carry(self, s: Signals) -> Tensor:
        """Lift; then the tip before the opening, and through it as far as it is aimed."""
        lift = s.lift_position - s.pickup_point
        offset = s.needle_tip - s.goal
        depth = geo.dot(offset, s.hoop_axis).unsqueeze(-1)
        radial = offset - depth * s.hoop_axis
        aside = torch.sqrt(geo.dot(radial, radial)).unsqueeze(-1) / self.layout.hoop_opening
        aimed = _ramp(aside, _ASTRAY, _AIMED)
        wanted = -STANDOFF + aimed * (self.past + STANDOFF)
        insert = (wanted - depth) * s.hoop_axis - radial
        return torch.where(s.lifted.unsqueeze(-1), insert, lift)

    def _jaw(self, s: Signals) -> Tensor:
        """Shut by as much as the needle is between the jaws, and while it is held."""
        near = _ramp(geo.distance(s.tool_midpoint, s.pickup_point), _FAR, _NEAR)
        shut = torch.where(s.grasped, torch.ones_like(near), near)
        wanted = self.layout.tool_jaw + shut * (self.layout.jaw_closed - self.layout.tool_jaw)
        return (GAIN * (wanted - s.jaw_command) / self.episode.jaw).clamp(-1, 1)


def smooth(layout: Layout, episode: Episode) -> Smooth:
    """The controller that threads the needle and can be imitated."""
    return Smooth(layout, episode, past=episode.thread_depth + 0.004)


def _ramp(value: Tensor, none: float, all_: float) -> Tensor:
    """0 up to ``none``, 1 from ``all_`` on, a straight line between; either may be the larger."""
    return ((value - none) / (all_ - none)).clamp(0.0, 1.0)
