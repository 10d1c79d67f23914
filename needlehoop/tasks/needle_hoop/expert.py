"""Scripted controllers: an expert that threads the needle, and a cheat that does not.

They see signals and act through the agent's own actions, so what they do an agent can.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.signals import Signals
from needlehoop.tasks.needle_hoop.layout import NeedleLayout
from needlehoop.tasks.needle_hoop.rules import NeedleRules

GAIN = 0.4
"""Share of the remaining error that an action asks for; the servos lag behind."""
HOVER = 0.012
"""Height above the pickup point at which the open jaws line up, m."""
STANDOFF = 0.010
"""Distance before the hoop's plane at which the tip lines up with the opening, m."""


@dataclass(frozen=True)
class Script:
    """A controller for ``control=tip``, without memory: phases follow from the signals.

    Args:
        layout: sizes.
        episode: action scales.
        past: how far beyond the hoop's plane the tip is sent, m; negative stops short.
    """

    layout: NeedleLayout
    episode: NeedleRules
    past: float

    def __post_init__(self) -> None:
        if self.episode.control != "tip":
            raise ValueError(
                f"episode.control: {self.episode.control!r}; the expert drives control=tip"
            )

    def __call__(self, signals: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        s = signals
        held = s.grasped.unsqueeze(-1)
        aligned = self._needle_turn(s)
        move = torch.where(held, self._carry(s), self._approach(s, aligned))
        turn = torch.where(s.grasped, self._insertion_turn(s) * s.lifted, aligned)
        translation = (GAIN * move / self.episode.translation).clamp(-1, 1)
        rotation = (GAIN * turn / self.episode.rotation).clamp(-1, 1)
        jaw = self._jaw(s)
        return torch.cat((translation, rotation.unsqueeze(-1), jaw.unsqueeze(-1)), -1)

    def _approach(self, s: Signals, misaligned: Tensor) -> Tensor:
        """Above the pickup point, then down onto it once lined up."""
        away = s.pickup_point - s.tool_midpoint
        aside = torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2)
        lined_up = (aside < 0.0012) & (misaligned.abs() < 0.12)
        low = away[:, 2].abs() < 0.006
        descend = lined_up | (low & (aside < 0.0025))
        away[:, 2] = torch.where(descend, away[:, 2], away[:, 2] + HOVER)
        return away

    def _carry(self, s: Signals) -> Tensor:
        """Squeeze, lift, line the tip up before the opening, push it through."""
        squeezing = s.jaw_command > self.layout.jaw_closed + 0.02
        lift = s.lift_position - s.pickup_point
        offset = s.needle_tip - s.goal
        depth = geo.dot(offset, s.hoop_axis).unsqueeze(-1)
        radial = offset - depth * s.hoop_axis
        aside = torch.sqrt(geo.dot(radial, radial)).unsqueeze(-1)
        through = (aside < 0.25 * self.layout.hoop_opening) | (
            (depth > -STANDOFF / 2) & (aside < 0.5 * self.layout.hoop_opening)
        )
        ahead = torch.where(through, self.past - depth, -STANDOFF - depth)
        insert = ahead * s.hoop_axis - radial
        move = torch.where(s.lifted.unsqueeze(-1), insert, lift)
        return torch.where(squeezing.unsqueeze(-1), torch.zeros_like(move), move)

    def _jaw(self, s: Signals) -> Tensor:
        """Close when the needle is between the jaws and while it is held; else open."""
        near = geo.distance(s.tool_midpoint, s.pickup_point) < 0.0012
        wanted = torch.where(s.grasped | near, self.layout.jaw_closed, self.layout.tool_jaw)
        return ((wanted - s.jaw_command) / self.episode.jaw).clamp(-1, 1)

    def _needle_turn(self, s: Signals) -> Tensor:
        """Rotation about the instrument that lays the blades along the needle, rad."""
        n = len(s.jaw)
        across = _direction(s.needle_quat, (1.0, 0.0, 0.0), n)
        x, y, _ = geo.rotate(geo.conjugate(s.tool_quat), across).unbind(-1)
        # The blades open along the tool's y; either sense will do.
        sense = torch.where(y < 0, -1.0, 1.0)
        return geo.angle(y * sense, -x * sense)

    def _insertion_turn(self, s: Signals) -> Tensor:
        """Rotation about the instrument that points the tip along the hoop's axis, rad."""
        n = len(s.jaw)
        _, tip = self.layout.needle_angles
        pointing = _direction(s.needle_quat, (float(np.sin(tip)), float(np.cos(tip)), 0.0), n)
        inverse = geo.conjugate(s.tool_quat)
        ax, ay, _ = geo.rotate(inverse, pointing).unbind(-1)
        bx, by, _ = geo.rotate(inverse, s.hoop_axis).unbind(-1)
        return geo.angle(ax * bx + ay * by, ax * by - ay * bx)


def expert(layout: NeedleLayout, episode: NeedleRules) -> Script:
    """The controller that threads the needle."""
    return Script(layout, episode, past=episode.thread_depth + 0.004)


def cheat(layout: NeedleLayout, episode: NeedleRules) -> Script:
    """The controller that touches the goal from before the opening and stays there."""
    return replace(expert(layout, episode), past=-0.6 * episode.goal_radius)


def _direction(quat: Tensor, axis: tuple[float, float, float], n: int) -> Tensor:
    return geo.rotate(quat, torch.tensor(axis, dtype=quat.dtype).expand(n, 3))
