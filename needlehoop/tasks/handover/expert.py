"""A sharp expert, one that can be imitated, and a cheat whose second arm fetches the needle."""

from __future__ import annotations

from types import SimpleNamespace

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot.geometry import ramp
from needlehoop.scene.signals import Signals
from needlehoop.tasks.handover.scene import HandoverLayout, HandoverRules
from needlehoop.tasks.scripted import Funnel, Script, blade_turn, choose, descend

_HOVER = 0.012
"""Height above a pickup point at which the open jaws line up, m."""
_MET = 0.004
"""Distance of the needle's middle from the meeting place within which PSM 2 comes for it, m."""


class Expert:
    """The sharp expert."""

    def __init__(self, layout: HandoverLayout, episode: HandoverRules):
        self.layout = layout
        self.script_1, self.script_2 = Script(layout.psm1, episode), Script(layout.psm2, episode)

    def __call__(self, s: Signals) -> Tensor:
        """Actions ``(n, 10)`` float64 for the signals of ``n`` environments."""
        return torch.cat((self._first(s), self._second(s)), -1)

    def _first(self, s: Signals) -> Tensor:
        """PSM 1 takes the needle to the meeting place, and leaves it once PSM 2 holds it."""
        hand = self.hand(s, 1)
        turn = blade_turn(hand, hand.quat)
        taken = s.grasped_2 & (s.psm2_jaw_command < self.layout.psm2.jaw_closed + 0.02)
        carry = self.script_1.squeezed(s.meeting - s.needle_middle, hand)
        move = choose(s.grasped_1, carry, descend(hand, turn, _HOVER, askew=0.12))
        # It lets go before it moves.
        loose = taken & ~s.grasped_1 & (s.psm1_jaw > 0.6)
        away = choose(loose, _to(self.layout.psm1.tool_position, hand), torch.zeros_like(move))
        jaw = self.script_1.jaw_to((s.grasped_1 | _is_near(hand)) & ~taken, hand)
        return self.script_1.action(choose(taken, away, move), turn * ~(s.grasped_1 | taken), jaw)

    def _second(self, s: Signals) -> Tensor:
        """PSM 2 waits, takes the needle at the meeting place and keeps it there."""
        hand = self.hand(s, 2)
        turn = blade_turn(hand, hand.quat)
        comes = self._comes(s)
        approach = descend(hand, turn, _HOVER, askew=0.12)
        free = choose(comes, approach, _to(self.layout.psm2.tool_position, hand))
        keep = self.script_2.squeezed(s.meeting - s.needle_middle, hand)
        keep = choose(s.grasped_1, torch.zeros_like(keep), keep)
        jaw = self.script_2.jaw_to(s.grasped_2 | (comes & _is_near(hand)), hand)
        return self.script_2.action(choose(s.grasped_2, keep, free), turn * ~s.grasped_2, jaw)

    def _comes(self, s: Signals) -> Tensor:
        """Whether PSM 2 comes for the needle ``(n,)``."""
        met = geo.distance(s.needle_middle, s.meeting) < _MET
        return s.grasped_1 & s.lifted & met

    def hand(self, s: Signals, arm: int) -> SimpleNamespace:
        """An arm's tool, its pickup point and the needle's frame there."""
        tool = {
            name: getattr(s, f"psm{arm}_{name}")
            for name in ("tool_midpoint", "tool_quat", "jaw", "jaw_command")
        }
        # Further along the arc the frame is turned clockwise.
        turn = geo.about_z(torch.full_like(s.elapsed, -self.layout.thirds[arm - 1]))
        quat = geo.multiply(s.needle_quat, turn)
        return SimpleNamespace(**tool, pickup_point=getattr(s, f"pickup_{arm}"), quat=quat)


_FUNNEL, _HELD_UP = Funnel(), Funnel(height=(0.005, 0.0015))
"""No table stops the jaws, so they shut lower: a needle deeper between them is held as well."""

_LOW, _HIGH = 0.010, 0.020
"""Heights of the needle's middle, m, between which PSM 2 comes for it, and PSM 1 leaves a needle
that it does not hold."""


class Smooth(Expert):
    """The expert's phases with ramps for its switches: actions change little where signals do."""

    def _first(self, s: Signals) -> Tensor:
        hand = self.hand(s, 1)
        height = s.needle_middle[:, 2]
        high = ramp(height, _LOW, _HIGH)
        leave = _to(self.layout.psm1.tool_position, hand)
        # The wider the jaws are open, the faster.
        leave = leave * ramp(s.psm1_jaw, 0.5, 0.9).unsqueeze(-1)
        free = torch.lerp(_FUNNEL.approach(self.script_1, hand), leave, high.unsqueeze(-1))
        carry = s.meeting - s.needle_middle
        # Straight up and slowly until the needle is off the table.
        off, most = self.script_1.rising(height - self.layout.needle_thickness / 2)
        carry[:, :2] *= off.unsqueeze(-1)
        carry[:, 2] = torch.minimum(carry[:, 2], most)
        carry = choose(s.grasped_2, torch.zeros_like(carry), carry)
        near = _FUNNEL.near(hand) * (1.0 - high)
        shut = torch.where(s.grasped_1, 1.0 - s.grasped_2.double(), near)
        turn = blade_turn(hand, hand.quat) * (~s.grasped_1 * (1.0 - high))
        return self.script_1.action(choose(s.grasped_1, carry, free), turn, 1.0 - 2.0 * shut)

    def _second(self, s: Signals) -> Tensor:
        hand = self.hand(s, 2)
        comes = ramp(s.needle_middle[:, 2], _LOW, _HIGH)
        # As if the jaws were open: they have nothing to lift.
        still = SimpleNamespace(**{**vars(hand), "jaw": torch.full_like(hand.jaw, 1.3)})
        wait = _to(self.layout.psm2.tool_position, hand)
        free = torch.lerp(wait, _HELD_UP.approach(self.script_2, still), comes.unsqueeze(-1))
        keep = s.meeting - s.needle_middle
        keep = choose(s.grasped_1, torch.zeros_like(keep), keep)
        near = _HELD_UP.near(hand) * comes
        shut = torch.where(s.grasped_2, torch.ones_like(near), near)
        turn = blade_turn(hand, hand.quat) * ~s.grasped_2
        return self.script_2.action(choose(s.grasped_2, keep, free), turn, 1.0 - 2.0 * shut)


class Cheat(Expert):
    """PSM 1 stays away, and PSM 2 fetches the needle off the table."""

    def _first(self, s: Signals) -> Tensor:
        still = torch.zeros_like(s.psm1_tool_midpoint)
        return self.script_1.action(still, still[:, 0], still[:, 0])

    def _comes(self, s: Signals) -> Tensor:
        return torch.ones_like(s.grasped_1)


def _is_near(hand: SimpleNamespace) -> Tensor:
    """Whether the pickup point is between the jaws' tips ``(n,)``."""
    return geo.distance(hand.tool_midpoint, hand.pickup_point) < 0.0012


def _to(place: tuple[float, float, float], hand: SimpleNamespace) -> Tensor:
    """The move ``(n, 3)``, m, of a tool to a place."""
    return hand.tool_midpoint.new_tensor(place) - hand.tool_midpoint
