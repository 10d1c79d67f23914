"""A hand-written reward of the peg transfer."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.config.strict import Positive, Real
from needlehoop.robot.geometry import aside, distance
from needlehoop.scene.signals import Signals


@dataclass(frozen=True)
class Human:
    """Grasp, lift, carry, lower, place; values in ``conf/reward/human``.

    An episode's return is its last potential, so each term counts what has been reached and
    what is still so. A block that is neither held nor about the marked peg pays for nothing but
    the way to it. Lowering one beside the peg costs no more than what being over the peg is
    worth: else it would pay to hover. A block let go about the peg has up to 0.4 of the last
    term, the more the further off the jaws are: jaws that stay hold it aslant. Only a placed
    block has all of it, and what it has more is worth more than the time.
    """

    reach_rate: Positive
    carry_rate: Positive
    """How fast closeness falls with distance, to the side and down, 1/m."""
    grasp: Real
    lift: Real
    carry: Real
    lower: Real
    place: Real
    time: Real

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        s = signals
        one, none = torch.ones_like(s.elapsed), torch.zeros_like(s.elapsed)
        about = s.over & s.arrived
        kept = s.grasped | about
        off = s.block_position[:, 2] - s.goal[:, 2]
        rise = (off / (s.above_goal[:, 2] - s.goal[:, 2])).clamp(0.0, 1.0)
        carried_off = torch.logical_or(s.lifted, s.over).logical_or(s.arrived)
        raised = torch.where(carried_off, one, 0.8 * rise)
        close = torch.exp(-self.carry_rate * aside(s.block_position - s.goal))
        carried = torch.where(s.over, one, 0.8 * close)
        lowered = torch.exp(-self.carry_rate * off.clamp(min=0.0))
        reach = torch.exp(-self.reach_rate * distance(s.tool_midpoint, s.pickup_point))
        left = torch.where(about & ~s.grasped, 0.4 * (1.0 - reach), none)
        return {
            "grasp": self.grasp * torch.where(kept, one, 0.8 * reach),
            "lift": self.lift * torch.where(kept, raised, none),
            "carry": self.carry * torch.where(kept & carried_off, carried, none),
            "lower": self.lower * torch.where(kept & s.over, lowered, none),
            "place": self.place * torch.where(s.placed, one, left),
            "time": -self.time * s.elapsed,
        }
