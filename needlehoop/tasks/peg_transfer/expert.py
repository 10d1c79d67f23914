"""A sharp expert, one that can be imitated, and a cheat that never lets go."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot.geometry import ramp
from needlehoop.scene.signals import Signals
from needlehoop.tasks.peg_transfer.facts import lower_edge
from needlehoop.tasks.scripted import Funnel, Script, blade_turn, choose, descend

_HOVER = 0.016
"""Height above the pickup point at which the open jaws line up, m."""
_LOWERED = 0.0014
"""Distance of the hole's centre from the peg's axis at which the block is lowered, m."""


class Expert(Script):
    """The sharp expert."""

    lets_go = 0.0012
    """Height of the block's lower edge above the board below which the jaws open over the marked
    peg, m; negative: never."""

    def __call__(self, s: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        # The blades along the wall.
        turn = blade_turn(s, s.block_quat)
        done = s.over & s.arrived & ~s.grasped
        approach = descend(s, turn, _HOVER, askew=0.1)
        move = choose(s.grasped, self._carry(s), approach)
        move = choose(done, self._up(s, (s.jaw > 0.6) * _HOVER), move)
        return self.action(move, turn * (~s.grasped & ~done), self._jaw(s, done))

    def low(self, s: Signals) -> Tensor:
        """Height of the block's lower edge ``(n,)``, m: the arm leans, and the block with it."""
        return lower_edge(self.layout, s.block_position, s.block_quat)

    def _carry(self, s: Signals) -> Tensor:
        """Squeeze, lift off the peg, carry above the marked peg, lower."""
        away = s.goal - s.block_position
        down = (geo.aside(away) < _LOWERED) | (s.over & ~s.lifted)
        # Upwards first: below the pegs' tops there is no way aside.
        clear = s.lifted | down
        climb = self.layout.marked_height + self.layout.carry_height - self.low(s)
        level = torch.cat((away[:, :2] * clear.unsqueeze(-1), climb.unsqueeze(-1)), -1)
        return self.squeezed(choose(down, away, level), s)

    def _up(self, s: Signals, height: Tensor) -> Tensor:
        """Straight up ``(n, 3)``, m, when the jaws have let go."""
        up = torch.zeros_like(s.tool_midpoint)
        up[:, 2] = height
        return up

    def _jaw(self, s: Signals, done: Tensor) -> Tensor:
        """Close when the wall is between the jaws and while it is held, until it is down."""
        near = geo.distance(s.tool_midpoint, s.pickup_point) < 0.0014
        down = s.over & (self.low(s) < self.lets_go)
        return self.jaw_to((s.grasped | near) & ~down & ~done, s)


_FUNNEL = Funnel(
    free=0.0035, edge=0.008, height=(0.005, 0.002), aside=(0.009, 0.004), shut=(0.40, 0.25)
)

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


class Smooth(Expert):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def __call__(self, s: Signals) -> Tensor:
        """As the expert's."""
        aside, low = geo.aside(s.goal - s.block_position), self.low(s)
        sunk = ramp(low, self.layout.marked_height, 0.5 * self.layout.marked_height)
        about = ramp(aside, _BESIDE, _ABOUT)
        home = about * sunk
        # The faster up the wider the jaws are open.
        leave = self._up(s, self.asking(1.0) * ramp(s.jaw, 0.4, 0.8))
        free = torch.lerp(_FUNNEL.approach(self, s), leave, home.unsqueeze(-1))
        move = choose(s.grasped, self._transfer(s, aside, low), free)
        # So low, it must be about the peg, even if it seems to be beside it.
        lets_go = about * ramp(low, _HOLD, _OPEN)
        shut = torch.where(s.grasped, 1.0 - lets_go, _FUNNEL.near(s) * (1.0 - home))
        turn = blade_turn(s, s.block_quat) * (~s.grasped * (1.0 - home))
        return self.action(move, turn, 1.0 - 2.0 * shut)

    def _transfer(self, s: Signals, aside: Tensor, low: Tensor) -> Tensor:
        """Up and slowly until the block is off the board, to the marked peg, and down about it."""
        away = s.goal - s.block_position
        centred = ramp(aside, _FAR, _CENTRED)
        top = self.layout.marked_height
        clear = ramp(low, top - _CLEAR, top + _CLEAR)
        about = ramp(aside, _BESIDE, _ABOUT)
        away[:, :2] *= torch.maximum(clear, about).unsqueeze(-1)
        height = torch.lerp(top + self.layout.carry_height - low, -_BELOW - low, centred)
        _, most = self.rising(s.block_position[:, 2] - self.layout.block_height / 2)
        away[:, 2] = torch.minimum(height, most)
        return away


class Cheat(Expert):
    """It holds the block about the marked peg and never lets go."""

    lets_go = -1.0
