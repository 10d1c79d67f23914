"""A hand-written reward of the handover."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from needlehoop.config.strict import Positive, Real
from needlehoop.robot.geometry import distance
from needlehoop.scene.signals import Signals
from needlehoop.tasks.psm import outside_jaws

_WIDE_OPEN = 1.35
"""Angle of jaws that pay nothing for being shut, rad."""


@dataclass(frozen=True)
class Human:
    """Grasp, lift, take, give; values in ``conf/reward/human/handover.yaml``.

    An episode's return is its last potential, so each term counts what is so now. A needle that
    PSM 2 holds pays only if it was handed over in the air: one that it fetched off the table, or
    picked up after a fall, pays for nothing but PSM 1's way to it. Until both hold the needle an
    arm earns up to 0.8 of its grasp by its way there and by shutting its jaws about the needle.
    Letting go earns little before PSM 1 has let go, and its whole term once the needle is handed.
    """

    rate: Positive
    """How fast closeness falls with distance, 1/m."""
    gap_rate: Positive
    """The same for the distance from the gap between the blades."""
    grasp: Real
    lift: Real
    take: Real
    give: Real
    time: Real

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        s = signals
        one = torch.ones_like(s.elapsed)
        held = torch.logical_or(s.grasped_1, s.released)
        taken = torch.logical_or(s.both, s.released)
        up = held * self._closeness(s.needle_middle, s.meeting)
        opened = (s.psm1_jaw_command / _WIDE_OPEN).clamp(0.0, 1.0)
        given = 0.4 * s.both * opened + (0.7 + 0.3 * s.handed) * s.released
        return {
            "grasp": self.grasp * torch.where(held, one, self._about(s, 1)),
            "lift": self.lift * up,
            "take": self.take * torch.where(taken, one, up * s.lifted * self._about(s, 2)),
            "give": self.give * given,
            "time": -self.time * s.elapsed,
        }

    def _about(self, s: Signals, arm: int) -> Tensor:
        """How near an arm is to holding the needle at its pickup point, from 0 to 0.8 ``(n,)``."""
        tool, wrist, quat, jaw, told = (
            getattr(s, f"psm{arm}_{name}")
            for name in ("tool_midpoint", "wrist_pos", "tool_quat", "jaw", "jaw_command")
        )
        pickup = getattr(s, f"pickup_{arm}")
        away = outside_jaws(wrist, quat, jaw, pickup.unsqueeze(1)).squeeze(1)
        shut = (1.0 - told / _WIDE_OPEN).clamp(0.0, 1.0) * (away == 0)
        near = torch.exp(-self.gap_rate * away)
        return 0.3 * self._closeness(tool, pickup) + 0.2 * near + 0.3 * shut

    def _closeness(self, a: Tensor, b: Tensor) -> Tensor:
        return torch.exp(-self.rate * distance(a, b))
