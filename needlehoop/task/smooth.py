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

_UPRIGHT = 1.0
"""How much more a distance counts that lies above the pickup point, not aside of it."""

_PRESS = 0.0015
"""How far below the pickup point the jaws are sent, m: onto the table, wherever it seems to be."""

_FREE, _SLOPE = 0.003, 1.5
"""The funnel above the pickup point: its radius at the bottom, m, and its slope."""

_SHUT, _RISE, _REOPEN = (1.0, 0.4), (0.36, 0.26), (0.25, 0.1)
"""Angles of the jaws, rad, from none to all: too shut to go down onto the needle; so shut that
there is only up, since a needle between them keeps them 0.37 open: with it they lift, without it
they try again; and to be opened for that. They rise before they open: the other way round they
would rest at an angle between shutting and opening."""

_AIMED, _ASTRAY = 0.25, 0.75
"""Distance of the tip aside of the hoop's axis, in radii of the opening, at which it is sent all
the way through, and held before the hoop."""


@dataclass(frozen=True)
class Smooth(Script):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def _approach(self, s: Signals, misaligned: Tensor) -> Tensor:
        """Down a funnel: the nearer above the pickup point, the lower; with open jaws alone."""
        away = s.pickup_point - s.tool_midpoint
        aside = torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2)
        shut = _ramp(s.jaw, *_SHUT) * (1.0 - self._nearness(s))
        funnel = (_SLOPE * (aside - _FREE)).clamp(0.0, HOVER)
        height = torch.maximum(funnel, HOVER * torch.maximum(shut, _ramp(s.jaw, *_RISE)))
        away[:, 2] += height - _PRESS
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
        """Shut by as much as the needle is between the jaws, and while it is held.

        Jaws that have shut on nothing open again.
        """
        near = self._nearness(s) * (1.0 - _ramp(s.jaw, *_REOPEN))
        shut = torch.where(s.grasped, torch.ones_like(near), near)
        wanted = self.layout.tool_jaw + shut * (self.layout.jaw_closed - self.layout.tool_jaw)
        return (GAIN * (wanted - s.jaw_command) / self.episode.jaw).clamp(-1, 1)

    def _nearness(self, s: Signals) -> Tensor:
        """0 where the jaws are to be open, 1 where they are to be shut."""
        x, y, z = (s.pickup_point - s.tool_midpoint).unbind(-1)
        return _ramp(torch.sqrt(x**2 + y**2 + (_UPRIGHT * z) ** 2), _FAR, _NEAR)


def smooth(layout: Layout, episode: Episode) -> Smooth:
    """The controller that threads the needle and can be imitated."""
    return Smooth(layout, episode, past=episode.thread_depth + 0.004)


def _ramp(value: Tensor, none: float, all_: float) -> Tensor:
    """0 up to ``none``, 1 from ``all_`` on, a straight line between; either may be the larger."""
    return ((value - none) / (all_ - none)).clamp(0.0, 1.0)
