"""A scripted expert that can be imitated from images: nothing it does hangs by a millimetre."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.robot.geometry import ramp
from needlehoop.scene.signals import Signals
from needlehoop.tasks.peg_transfer.expert import GAIN, Script, aside_of
from needlehoop.tasks.peg_transfer.layout import PegLayout
from needlehoop.tasks.peg_transfer.rules import PegRules

# A learner that sees images of 64 px knows places to 2 or 3 mm. It does what the expert would do
# on average over what may be there. So every switch is a ramp, wider than that. Where the arm is
# to arrive, the target lies beyond: half of a small action leads nowhere.

_HOVER, _FREE, _SLOPE = 0.012, 0.0035, 1.5
"""The funnel above the pickup point: its height, its radius at the bottom, m, and its slope."""

_PRESS, _EDGE = 0.003, 0.008
"""How far below the pickup point the jaws are sent, m: until the wrist meets the block; and the
distance aside at which not at all."""

_LOW, _HIGH = 0.002, 0.005
"""Heights above the pickup point at which the jaws shut and open, m."""

_OVER, _ASIDE = 0.004, 0.009
"""The same for distances aside of it."""

_SHUT = (0.40, 0.25)
"""Angles of the jaws, rad, between which they begin to rise. A wall between them keeps them 0.3
open, and no image shows whether it is held yet."""

_START, _OFF = 0.3, (0.002, 0.008)
"""The action with which they rise; and the block's heights above the board, m, at which it is seen
to come along, not at all and for sure. So closing, holding and having missed ask for nearly the
same until it shows which it is."""

_JAMMED, _ABOVE = (0.9, 0.5), (0.003, 0.006)
"""Angles of the jaws, rad, and heights of them, m, at which they would come down on the wall: none
and all of that. There the only way is up."""

_CLEAR = 0.002
"""Half the range of heights about the marked peg's top, m, over which the block starts to move
aside."""

_FAR, _CENTRED = 0.007, 0.0035
"""Distances from the marked peg's axis at which the block is carried and lowered, m."""

_BELOW = 0.006
"""How far below the board it is sent, m."""

_OPEN, _HOLD = 0.0045, 0.008
"""Heights of its lower edge above the board at which the jaws open over the peg and stay shut."""

_ABOUT, _BESIDE = 0.006, 0.010
"""Distances of a block from the marked peg's axis at which it is left alone, and fetched."""


@dataclass(frozen=True)
class Smooth(Script):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def __call__(self, signals: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        s = signals
        aside, low = aside_of(s.goal - s.block_position), self.low(s)
        sunk = ramp(low, self.layout.marked_height, 0.5 * self.layout.marked_height)
        home = ramp(aside, _BESIDE, _ABOUT) * sunk
        turn = self.turn(s)
        free = torch.lerp(self._approach(s, turn), self._leave(s), home.unsqueeze(-1))
        move = torch.where(s.grasped.unsqueeze(-1), self._transfer(s, aside, low), free)
        # That low it is about the peg, wherever it seems to be.
        lets_go = ramp(aside, _BESIDE, _ABOUT) * ramp(low, _HOLD, _OPEN)
        shut = torch.where(s.grasped, 1.0 - lets_go, self._near(s) * (1.0 - home))
        return self.action(move, turn * (~s.grasped * (1.0 - home)), 1.0 - 2.0 * shut)

    def _approach(self, s: Signals, turn: Tensor) -> Tensor:
        """Down a funnel about the wall; up, where the jaws shut too early or on nothing."""
        away = s.pickup_point - s.tool_midpoint
        aside = aside_of(away)
        funnel = (_SLOPE * (aside - _FREE)).clamp(0.0, _HOVER)
        down = away[:, 2] + funnel - _PRESS * ramp(aside, _EDGE, _FREE)
        begun = torch.full_like(down, self._asking(_START))
        height = torch.lerp(down, begun, ramp(s.jaw, *_SHUT))
        jammed = ramp(s.jaw, *_JAMMED) * ramp(-away[:, 2], *_ABOVE)
        away[:, 2] = torch.lerp(height, away[:, 2] + _HOVER, jammed)
        return away

    def _transfer(self, s: Signals, aside: Tensor, low: Tensor) -> Tensor:
        """Up and slowly until the block is off the board, to the marked peg, and down about it."""
        away = s.goal - s.block_position
        centred = ramp(aside, _FAR, _CENTRED)
        top = self.layout.marked_height
        clear = ramp(low, top - _CLEAR, top + _CLEAR)
        about = ramp(aside, _BESIDE, _ABOUT)
        away[:, :2] *= torch.maximum(clear, about).unsqueeze(-1)
        height = torch.lerp(self.carried - low, -_BELOW - low, centred)
        off = ramp(s.block_position[:, 2] - self.layout.block_height / 2, *_OFF)
        fastest = torch.lerp(torch.full_like(off, _START), torch.ones_like(off), off)
        away[:, 2] = torch.minimum(height, self._asking(1.0) * fastest)
        return away

    def _leave(self, s: Signals) -> Tensor:
        """Straight up, the faster the wider the jaws are open."""
        up = torch.zeros_like(s.tool_midpoint)
        up[:, 2] = self._asking(1.0) * ramp(s.jaw, 0.4, 0.8)
        return up

    def _near(self, s: Signals) -> Tensor:
        """How surely the wall is between the jaws, from 0 to 1 ``(n,)``."""
        away = s.tool_midpoint - s.pickup_point
        return ramp(away[:, 2], _HIGH, _LOW) * ramp(aside_of(away), _ASIDE, _OVER)

    def _asking(self, action: float) -> float:
        """The distance, m, for which an action is asked."""
        return action * self.episode.translation / GAIN


def smooth(layout: PegLayout, episode: PegRules) -> Smooth:
    """The controller that transfers the block and can be imitated."""
    return Smooth(layout, episode, lets_go=_OPEN)
