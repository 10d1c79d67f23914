"""A scripted expert that can be imitated from images: nothing it does hangs by a millimetre."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot.geometry import ramp
from needlehoop.scene.signals import Signals
from needlehoop.tasks.needle_hoop.expert import GAIN, HOVER, STANDOFF, Script
from needlehoop.tasks.needle_hoop.layout import NeedleLayout
from needlehoop.tasks.needle_hoop.rules import NeedleRules

# Who learns from images of 64 px knows places to 2 or 3 mm and does what the expert would do on
# average over what may be there. So every switch is a ramp, wider than that; and where the arm
# is to arrive, the target lies beyond, since half of a small action leads nowhere.

_FREE, _SLOPE = 0.005, 1.5
"""The funnel above the pickup point: its radius at the bottom, m, and its slope."""

_PRESS, _EDGE = 0.003, 0.009
"""How far below the pickup point the jaws are sent, m: onto the table, where the workspace stops
them; and the distance aside at which not at all."""

_LOW, _HIGH = 0.004, 0.008
"""Heights above the pickup point at which the jaws shut and open, m."""

_OVER, _ASIDE = 0.006, 0.010
"""The same for distances aside of it."""

_SHUT = (0.45, 0.25)
"""Angles of the jaws, rad, between which they begin to rise. A needle between them keeps them
0.37 open, and whether it is held yet no image shows."""

_START, _OFF = 0.3, (0.002, 0.008)
"""The action with which they rise; and the needle's heights above the table, m, at which it is seen
to come along, not at all and for sure. So what closing, holding and having missed ask for hardly
differs until it shows which it is: held, the needle is lifted; missed, the jaws open again."""

_JAMMED, _ABOVE = (0.9, 0.5), (0.003, 0.006)
"""Angles of the jaws, rad, and heights of them, m, at which they would come down on the needle and
rest there: none and all of that. There too is only up."""

_AIMED, _ASTRAY = 0.35, 0.85
"""Distance of the tip aside of the hoop's axis, in radii of the opening, at which it is sent all
the way through, and held before the hoop."""

_THROUGH = 0.02
"""How far beyond the hoop's plane the tip is sent, m; the episode ends on the way."""


@dataclass(frozen=True)
class Smooth(Script):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def _approach(self, s: Signals, misaligned: Tensor) -> Tensor:
        """Down a funnel onto the table; up, where the jaws shut too early or on nothing."""
        away = s.pickup_point - s.tool_midpoint
        aside = _aside(s)
        funnel = (_SLOPE * (aside - _FREE)).clamp(0.0, HOVER)
        down = away[:, 2] + funnel - _PRESS * ramp(aside, _EDGE, _FREE)
        begun = torch.full_like(down, self._asking(_START))
        height = torch.lerp(down, begun, ramp(s.jaw, *_SHUT))
        jammed = ramp(s.jaw, *_JAMMED) * ramp(-away[:, 2], *_ABOVE)
        away[:, 2] = torch.lerp(height, away[:, 2] + HOVER, jammed)
        return away

    def _carry(self, s: Signals) -> Tensor:
        """Lift; then the tip before the opening, and through it as far as it is aimed."""
        lift = self._lift(s)
        offset = s.needle_tip - s.goal
        depth = geo.dot(offset, s.hoop_axis).unsqueeze(-1)
        radial = offset - depth * s.hoop_axis
        aside = torch.sqrt(geo.dot(radial, radial)).unsqueeze(-1) / self.layout.hoop_opening
        wanted = -STANDOFF + ramp(aside, _ASTRAY, _AIMED) * (self.past + STANDOFF)
        insert = (wanted - depth) * s.hoop_axis - radial
        return torch.where(s.lifted.unsqueeze(-1), insert, lift)

    def _lift(self, s: Signals) -> Tensor:
        """To the lift position; straight up and slowly until the needle is off the table."""
        lift = s.lift_position - s.pickup_point
        off = ramp(s.pickup_point[:, 2] - self.layout.needle_thickness / 2, *_OFF)
        fastest = torch.lerp(torch.full_like(off, _START), torch.ones_like(off), off)
        lift[:, :2] *= off.unsqueeze(-1)
        lift[:, 2] = torch.minimum(lift[:, 2], self._asking(1.0) * fastest)
        return lift

    def _asking(self, action: float) -> float:
        """The distance, m, for which an action is asked."""
        return action * self.episode.translation / GAIN

    def _jaw(self, s: Signals) -> Tensor:
        """Shut where the needle is between the jaws, and while it is held; else open.

        However far they have come: their angle is hard to see.
        """
        height = (s.tool_midpoint - s.pickup_point)[:, 2]
        near = ramp(height, _HIGH, _LOW) * ramp(_aside(s), _ASIDE, _OVER)
        return 1.0 - 2.0 * torch.where(s.grasped, torch.ones_like(near), near)


def smooth(layout: NeedleLayout, episode: NeedleRules) -> Smooth:
    """The controller that threads the needle and can be imitated."""
    return Smooth(layout, episode, past=_THROUGH)


def _aside(s: Signals) -> Tensor:
    """Horizontal distance of the tool from the pickup point ``(n,)``, m."""
    return torch.linalg.vector_norm((s.pickup_point - s.tool_midpoint)[:, :2], dim=-1)
