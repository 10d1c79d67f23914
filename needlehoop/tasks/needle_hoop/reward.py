"""The paper's hand-written reward (its appendix A)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.config.strict import Amount, Positive, Real
from needlehoop.robot.geometry import distance
from needlehoop.scene.signals import Signals
from needlehoop.tasks.psm import outside_jaws

_WIDE_OPEN = 1.396
"""Angle of the jaws at their limit, rad."""


@dataclass(frozen=True)
class Human:
    """Approach, grasp, lift, insert; values in ``conf/reward/human/needle_hoop.yaml``.

    ``tolerance``, ``rate`` and ``reach`` shape the distance terms
    ``exp(-rate * clamp(d - tolerance, 0, reach))``, where ``d`` is in scene units of ``unit`` m.
    The paper gives 0.05, 4 and 100 for them, and does not give the unit. We chose 1/10 m. Half
    of it would fit the size of the paper's instrument, but agents learn from it more slowly
    (``results/README.md``). We chose the weights too; those of the paper's terms sum to its
    highest value, 9.
    """

    unit: Positive
    tolerance: Amount
    rate: Amount
    reach: Amount
    grasp: Real
    lift: Real
    hoop: Real
    closed: Real
    closed_below: Real
    """The closed-jaw bonus needs a jaw command below this, rad."""
    time: Real
    surround: Real = 0.0
    """Ours, as is ``pinch``; runs from before had neither. The paper's terms pay for a tool near
    the needle, whether its jaws are open or shut. This one pays for the gap between the blades:
    ``exp(-surround_rate * d)`` at a distance of ``d`` m from the pickup point."""
    surround_rate: Amount = 0.0
    pinch: Real = 0.0
    """For shutting the jaws while the pickup point is in the gap. Both are whole in a grasp."""

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        s = signals
        one = torch.ones_like(s.elapsed)
        reach = self._closeness(s.tool_midpoint, s.pickup_point)
        raise_ = self._closeness(s.pickup_point, s.lift_position)
        insert = self._closeness(s.needle_tip, s.goal)
        closed = s.grasped & (s.jaw_command < self.closed_below)
        away = outside_jaws(s.wrist_pos, s.tool_quat, s.jaw, s.pickup_point.unsqueeze(1)).squeeze(1)
        near = torch.exp(-self.surround_rate * away)
        shut = (1.0 - s.jaw_command / _WIDE_OPEN).clamp(0.0, 1.0) * (away == 0)
        return {
            "grasp": self.grasp * torch.where(s.grasped, one, reach),
            "lift": self.lift * torch.where(s.lifted, one, raise_),
            "hoop": self.hoop * insert * s.lifted,
            "closed": self.closed * closed.double(),
            "surround": self.surround * torch.where(s.grasped, one, near),
            "pinch": self.pinch * torch.where(s.grasped, one, shut),
            "time": -self.time * s.elapsed,
        }

    def _closeness(self, a: Tensor, b: Tensor) -> Tensor:
        beyond = distance(a, b) - self.tolerance * self.unit
        return torch.exp(-self.rate / self.unit * beyond.clamp(0.0, self.reach * self.unit))
