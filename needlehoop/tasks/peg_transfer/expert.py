"""A scripted expert that transfers the block, and a cheat that does not let go.

They see signals and act through the agent's own actions, so what they do an agent can.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.signals import Signals
from needlehoop.tasks.peg_transfer.facts import lower_edge
from needlehoop.tasks.peg_transfer.layout import PegLayout
from needlehoop.tasks.peg_transfer.rules import PegRules

GAIN = 0.4
"""Share of the remaining error that an action asks for; the servos lag behind."""
HOVER = 0.016
"""Height above the pickup point at which the open jaws line up, m."""
_CENTRED = 0.0014
"""Distance of the hole's centre from the peg's axis at which the block is lowered, m."""


@dataclass(frozen=True)
class Script:
    """A controller for ``control=tip``, without memory: phases follow from the signals.

    Args:
        layout: sizes.
        episode: action scales.
        lets_go: height of the block's lower edge above the board below which the jaws open over
            the marked peg, m; negative: never.
    """

    layout: PegLayout
    episode: PegRules
    lets_go: float

    def __post_init__(self) -> None:
        if self.episode.control != "tip":
            raise ValueError(
                f"episode.control: {self.episode.control!r}; the expert drives control=tip"
            )

    def __call__(self, signals: Signals) -> Tensor:
        """Actions ``(n, 5)`` float64 for the signals of ``n`` environments."""
        s = signals
        turn = self.turn(s)
        done = s.over & s.arrived & ~s.grasped
        move = torch.where(s.grasped.unsqueeze(-1), self._carry(s), self._approach(s, turn))
        move = torch.where(done.unsqueeze(-1), self._leave(s), move)
        free = (~s.grasped & ~done).double()
        return self.action(move, turn * free, self._jaw(s, done))

    def action(self, move: Tensor, turn: Tensor, jaw: Tensor) -> Tensor:
        """Actions that ask for a share of a move ``(n, 3)`` in m and a turn ``(n,)`` in rad."""
        translation = (GAIN * move / self.episode.translation).clamp(-1, 1)
        rotation = (GAIN * turn / self.episode.rotation).clamp(-1, 1)
        return torch.cat((translation, rotation.unsqueeze(-1), jaw.unsqueeze(-1)), -1)

    def turn(self, s: Signals) -> Tensor:
        """Rotation about the instrument that lays the blades along the wall, rad."""
        out = torch.tensor((1.0, 0.0, 0.0), dtype=torch.float64).expand(len(s.jaw), 3)
        across = geo.rotate(s.block_quat, out)
        x, y, _ = geo.rotate(geo.conjugate(s.tool_quat), across).unbind(-1)
        # The blades open along the tool's y; either sense will do.
        sense = torch.where(y < 0, -1.0, 1.0)
        return geo.angle(y * sense, -x * sense)

    def low(self, s: Signals) -> Tensor:
        """Height of the block's lower edge ``(n,)``, m: the arm leans, and the block with it."""
        return lower_edge(self.layout, s.block_position, s.block_quat)

    @property
    def carried(self) -> float:
        """Height at which a carried block's lower edge is, m."""
        return self.layout.marked_height + self.layout.carry_height

    def _approach(self, s: Signals, turn: Tensor) -> Tensor:
        """Above the pickup point, then down onto it once lined up."""
        away = s.pickup_point - s.tool_midpoint
        aside = aside_of(away)
        lined_up = (aside < 0.0012) & (turn.abs() < 0.1)
        low = away[:, 2].abs() < 0.006
        descend = lined_up | (low & (aside < 0.0025))
        away[:, 2] = torch.where(descend, away[:, 2], away[:, 2] + HOVER)
        return away

    def _carry(self, s: Signals) -> Tensor:
        """Squeeze, lift off the peg, carry above the marked peg, lower."""
        squeezing = s.jaw_command > self.layout.jaw_closed + 0.02
        away = s.goal - s.block_position
        aside = aside_of(away)
        down = (aside < _CENTRED) | (s.over & ~s.lifted)
        # Upwards first: below the pegs' tops there is no way aside.
        clear = s.lifted | down
        climb = self.carried - self.low(s)
        level = torch.cat((away[:, :2] * clear.unsqueeze(-1), climb.unsqueeze(-1)), -1)
        move = torch.where(down.unsqueeze(-1), away, level)
        return torch.where(squeezing.unsqueeze(-1), torch.zeros_like(move), move)

    def _leave(self, s: Signals) -> Tensor:
        """Straight up, once the jaws are open."""
        up = torch.zeros_like(s.tool_midpoint)
        up[:, 2] = torch.where(s.jaw > 0.6, HOVER, 0.0)
        return up

    def _jaw(self, s: Signals, done: Tensor) -> Tensor:
        """Close when the wall is between the jaws and while it is held, until it is down."""
        near = geo.distance(s.tool_midpoint, s.pickup_point) < 0.0014
        down = s.over & (self.low(s) < self.lets_go)
        shut = (s.grasped | near) & ~down & ~done
        wanted = torch.where(shut, self.layout.jaw_closed, self.layout.tool_jaw)
        return ((wanted - s.jaw_command) / self.episode.jaw).clamp(-1, 1)


def expert(layout: PegLayout, episode: PegRules) -> Script:
    """The controller that transfers the block."""
    return Script(layout, episode, lets_go=0.0012)


def cheat(layout: PegLayout, episode: PegRules) -> Script:
    """The controller that holds the block about the marked peg and never lets go."""
    return replace(expert(layout, episode), lets_go=-1.0)


def aside_of(away: Tensor) -> Tensor:
    """Horizontal length of vectors ``(n, 3)``, m."""
    return torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2)
