"""What scripted controllers of tasks with the PSM share.

They see signals and act through the agent's own actions. Two kinds go down onto a thing, grasp it
and rise. The sharp one has switches. The smooth one can be imitated from images: an agent that sees
images of 64 px knows places to 2 or 3 mm, and learns the expert's average action over that range.
So every switch is a ramp, wider than that. And targets lie beyond the place where the arm is to
arrive, because the average of small actions would stop before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot.geometry import ramp
from needlehoop.scene.signals import Signals

_GAIN = 0.4
"""Share of the remaining error that an action asks for; the servos lag behind."""

_START, _OFF = 0.3, (0.002, 0.008)
"""The action with which a thing begins to rise; and the heights off the ground, m, between which
it is more and more surely held. Until then the actions of closing, holding and having missed
hardly differ. A held thing then rises; over a missed one the jaws open again."""

_JAMMED, _ABOVE = (0.9, 0.5), (0.003, 0.006)
"""Angles of the jaws, rad, and their heights above the pickup point, m, between which they would
more and more surely rest on the thing. There they rise."""


@dataclass(frozen=True)
class Script:
    """A controller for ``control=tip``, without memory: phases follow from the signals.

    ``layout`` is an ``Arm``, ``episode`` a ``ToolEpisode``.
    """

    layout: Any
    episode: Any

    def __post_init__(self) -> None:
        if self.episode.control != "tip":
            raise ValueError(
                f"episode.control: {self.episode.control!r}; the expert drives control=tip"
            )

    def action(self, move: Tensor, turn: Tensor, jaw: Tensor) -> Tensor:
        """Actions ``(n, 5)`` that ask for a share of a move ``(n, 3)`` m and a turn ``(n,)`` rad.

        ``jaw`` ``(n,)`` is the action itself.
        """
        translation = (_GAIN * move / self.episode.translation).clamp(-1, 1)
        rotation = (_GAIN * turn / self.episode.rotation).clamp(-1, 1)
        return torch.cat((translation, rotation.unsqueeze(-1), jaw.unsqueeze(-1)), -1)

    def asking(self, action: float) -> float:
        """The distance, m, for which an action is asked."""
        return action * self.episode.translation / _GAIN

    def jaw_to(self, shut: Tensor, s: Signals) -> Tensor:
        """The jaw's action ``(n,)``: shut where ``shut`` ``(n,)`` is true, else open."""
        target = torch.where(shut, self.layout.jaw_closed, self.layout.tool_jaw)
        return ((target - s.jaw_command) / self.episode.jaw).clamp(-1, 1)

    def squeezed(self, move: Tensor, s: Signals) -> Tensor:
        """A move ``(n, 3)``, m; none until the jaws are told to be shut."""
        squeezing = s.jaw_command > self.layout.jaw_closed + 0.02
        return choose(squeezing, torch.zeros_like(move), move)

    def rising(self, height: Tensor) -> tuple[Tensor, Tensor]:
        """How surely a thing at this height ``(n,)``, m, is held (0 to 1), and the largest move up
        ``(n,)`` that is asked for, m."""
        off = ramp(height, *_OFF)
        fastest = torch.lerp(torch.full_like(off, _START), torch.ones_like(off), off)
        return off, self.asking(1.0) * fastest


@dataclass(frozen=True)
class Funnel:
    """How the smooth kind comes down on a thing, by default a thin one; m and rad."""

    free: float = 0.005
    """Radius of the funnel's bottom about the pickup point."""
    edge: float = 0.009
    """Distance aside beyond which the jaws are not sent below the pickup point."""
    height: tuple[float, float] = (0.008, 0.004)
    """Heights over the pickup point between which the jaws shut."""
    aside: tuple[float, float] = (0.010, 0.006)
    """Distances aside of it between which the jaws shut."""
    shut: tuple[float, float] = (0.45, 0.25)
    """Angles of the jaws between which they begin to rise. A thing between them keeps them open by
    more than the second, and images do not show whether it is held yet."""

    hover, slope, press = 0.012, 1.5, 0.003
    """Height and slope of the funnel; and how far below the pickup point the jaws are sent, until
    something stops them."""

    def approach(self, script: Script, s: Signals) -> Tensor:
        """Down the funnel; up, where the jaws shut too early or on nothing. ``(n, 3)``, m."""
        away = s.pickup_point - s.tool_midpoint
        aside = geo.aside(away)
        wall = (self.slope * (aside - self.free)).clamp(0.0, self.hover)
        down = away[:, 2] + wall - self.press * ramp(aside, self.edge, self.free)
        begun = torch.full_like(down, script.asking(_START))
        height = torch.lerp(down, begun, ramp(s.jaw, *self.shut))
        jammed = ramp(s.jaw, *_JAMMED) * ramp(-away[:, 2], *_ABOVE)
        away[:, 2] = torch.lerp(height, away[:, 2] + self.hover, jammed)
        return away

    def near(self, s: Signals) -> Tensor:
        """How surely the thing is between the jaws, from 0 to 1 ``(n,)``."""
        away = s.tool_midpoint - s.pickup_point
        return ramp(away[:, 2], *self.height) * ramp(geo.aside(away), *self.aside)


def descend(s: Signals, turn: Tensor, hover: float, askew: float) -> Tensor:
    """The sharp kind's way down ``(n, 3)``, m: above the pickup point, then onto it once lined up.

    Args:
        turn: about the instrument that is still missing ``(n,)``, rad.
        hover: height at which the open jaws line up, m.
        askew: turn that may be missing on the way down, rad.
    """
    away = s.pickup_point - s.tool_midpoint
    aside = geo.aside(away)
    lined_up = (aside < 0.0012) & (turn.abs() < askew)
    low = away[:, 2].abs() < 0.006
    down = lined_up | (low & (aside < 0.0025))
    away[:, 2] = torch.where(down, away[:, 2], away[:, 2] + hover)
    return away


def choose(where: Tensor, yes: Tensor, no: Tensor) -> Tensor:
    """Moves ``(n, 3)`` by a condition ``(n,)``."""
    return torch.where(where.unsqueeze(-1), yes, no)


def blade_turn(s: Signals, quat: Tensor) -> Tensor:
    """Turn about the instrument ``(n,)``, rad, after which the blades open along a frame's x."""
    across = direction(quat, 1.0, 0.0, 0.0)
    x, y, _ = geo.rotate(geo.conjugate(s.tool_quat), across).unbind(-1)
    # The blades open along the tool's y; either sense will do.
    sense = torch.where(y < 0, -1.0, 1.0)
    return geo.angle(y * sense, -x * sense)


def direction(quat: Tensor, *axis: float) -> Tensor:
    """An axis of turned frames ``(n, 4)`` in the world ``(n, 3)``."""
    return geo.rotate(quat, quat.new_tensor(axis).expand(len(quat), 3))
