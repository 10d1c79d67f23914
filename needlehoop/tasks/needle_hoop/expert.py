"""A sharp expert, one that can be imitated, and a cheat that does not thread."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot.geometry import ramp
from needlehoop.scene.signals import Signals
from needlehoop.tasks.scripted import Funnel, Script, blade_turn, choose, descend, direction

_HOVER = 0.012
"""Height above the pickup point at which the open jaws line up, m."""
_STANDOFF = 0.010
"""Distance before the hoop's plane at which the tip lines up with the opening, m."""


class Expert(Script):
    """The sharp expert."""

    def past(self) -> float:
        """How far beyond the hoop's plane the tip is sent, m; negative stops short."""
        return self.episode.thread_depth + 0.004

    def __call__(self, s: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        aligned = blade_turn(s, s.needle_quat)
        move = choose(s.grasped, self._carry(s), self._approach(s, aligned))
        turn = torch.where(s.grasped, self._insertion_turn(s) * s.lifted, aligned)
        return self.action(move, turn, self._jaw(s))

    def _approach(self, s: Signals, misaligned: Tensor) -> Tensor:
        return descend(s, misaligned, _HOVER, askew=0.12)

    def _carry(self, s: Signals) -> Tensor:
        """Squeeze, lift, line the tip up before the opening, push it through."""
        depth, radial, aside = _place_of_tip(s)
        through = (aside < 0.25 * self.layout.hoop_opening) | (
            (depth > -_STANDOFF / 2) & (aside < 0.5 * self.layout.hoop_opening)
        )
        ahead = torch.where(through, self.past() - depth, -_STANDOFF - depth)
        insert = ahead * s.hoop_axis - radial
        return self.squeezed(choose(s.lifted, insert, s.lift_position - s.pickup_point), s)

    def _jaw(self, s: Signals) -> Tensor:
        """Close when the needle is between the jaws and while it is held; else open."""
        near = geo.distance(s.tool_midpoint, s.pickup_point) < 0.0012
        return self.jaw_to(s.grasped | near, s)

    def _insertion_turn(self, s: Signals) -> Tensor:
        """Rotation about the instrument that points the tip along the hoop's axis, rad."""
        _, tip = self.layout.needle_angles
        pointing = direction(s.needle_quat, float(np.sin(tip)), float(np.cos(tip)), 0.0)
        inverse = geo.conjugate(s.tool_quat)
        ax, ay, _ = geo.rotate(inverse, pointing).unbind(-1)
        bx, by, _ = geo.rotate(inverse, s.hoop_axis).unbind(-1)
        return geo.angle(ax * bx + ay * by, ax * by - ay * bx)


_FUNNEL = Funnel()

_AIMED, _ASTRAY = 0.35, 0.85
"""Distances of the tip from the hoop's axis, in radii of the opening, at which it is sent all the
way through, and held before the hoop."""


class Smooth(Expert):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def past(self) -> float:
        """So far that the episode ends on the way."""
        return 0.02

    def _approach(self, s: Signals, misaligned: Tensor) -> Tensor:
        return _FUNNEL.approach(self, s)

    def _carry(self, s: Signals) -> Tensor:
        """Lift; then the tip before the opening, and through it as far as it is aimed."""
        depth, radial, aside = _place_of_tip(s)
        aimed = ramp(aside / self.layout.hoop_opening, _ASTRAY, _AIMED)
        target_depth = -_STANDOFF + aimed * (self.past() + _STANDOFF)
        insert = (target_depth - depth) * s.hoop_axis - radial
        # Straight up and slowly until the needle is off the table.
        lift = s.lift_position - s.pickup_point
        off, most = self.rising(s.pickup_point[:, 2] - self.layout.needle_thickness / 2)
        lift[:, :2] *= off.unsqueeze(-1)
        lift[:, 2] = torch.minimum(lift[:, 2], most)
        return choose(s.lifted, insert, lift)

    def _jaw(self, s: Signals) -> Tensor:
        """As the expert's, whatever the jaws' angle, which is hard to see."""
        near = _FUNNEL.near(s)
        return 1.0 - 2.0 * torch.where(s.grasped, torch.ones_like(near), near)


def _place_of_tip(s: Signals) -> tuple[Tensor, Tensor, Tensor]:
    """The tip beyond the hoop's plane ``(n, 1)``, from its axis ``(n, 3)``, and that length, m."""
    offset = s.needle_tip - s.goal
    depth = geo.dot(offset, s.hoop_axis).unsqueeze(-1)
    radial = offset - depth * s.hoop_axis
    return depth, radial, torch.sqrt(geo.dot(radial, radial)).unsqueeze(-1)


class Cheat(Expert):
    """It touches the goal from before the opening and stays there."""

    def past(self) -> float:
        """Short of the hoop's plane."""
        return -0.6 * self.episode.goal_radius
