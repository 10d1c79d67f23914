"""A hand-written reward of the handover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from needlehoop.config.strict import Positive, Range, Real
from needlehoop.robot.geometry import distance
from needlehoop.scene.signals import Signals
from needlehoop.tasks.psm import outside_jaws

_WIDE_OPEN = 1.35
"""Angle of jaws that pay nothing for being shut, rad."""


@dataclass(frozen=True)
class Human:
    """Grasp, lift, take, give; values in ``conf/reward/human/handover.yaml``.

    An episode's return is its last potential, so each term counts what is so now. A needle that
    PSM 2 holds pays only if it was handed over in the air, and not if it was fetched off the table
    or picked up after a fall. Until both hold the needle PSM 1 earns up to 0.3 of its term by its
    way, PSM 2 up to 0.5, and each up to 0.5 by shutting its jaws about the needle. Letting go earns
    little before PSM 1 has let go, and its whole term once the needle is handed.

    PSM 2's way pays from the start, and half of it for open jaws: an arm that is paid for nothing
    drifts away. It pays as much as a grasp, because what pays little is lost in the noise of what
    pays much. So a needle that is held up within the slack pays the same wherever it is.
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
    slack: Annotated[float, Range(0.0, 1.0)] = 0.0
    """So near to the meeting place the needle is as good as there, m; 0 in runs of before."""

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name."""
        s = signals
        one = torch.ones_like(s.elapsed)
        held = torch.logical_or(s.grasped_1, s.released)
        taken = torch.logical_or(s.both, s.released)
        rest = self._rest(s)
        up = held * torch.exp(-self.rate * rest.norm(dim=-1))
        way = self._closeness(s.psm1_tool_midpoint, s.pickup_1)
        away_1, away_2 = (_away(s, arm) for arm in (1, 2))
        # How far jaws are told to open, from 0 to 1.
        opened_1, opened_2 = (
            (command / _WIDE_OPEN).clamp(0.0, 1.0)
            for command in (s.psm1_jaw_command, s.psm2_jaw_command)
        )
        # Where PSM 2's pickup point will be once the needle is near enough to the meeting place.
        place = s.pickup_2 + rest
        # About the needle the jaws are to shut.
        ready = torch.where(away_2 == 0, one, opened_2)
        waiting = 0.25 * self._closeness(s.psm2_tool_midpoint, place) * (1.0 + ready)
        reach = 0.3 * way + self._jaws(away_1, opened_1)
        come = waiting + up * s.lifted * self._jaws(away_2, opened_2)
        given = 0.4 * s.both * opened_1 + (0.7 + 0.3 * s.handed) * s.released
        return {
            "grasp": self.grasp * torch.where(held, one, reach),
            "lift": self.lift * up,
            "take": self.take * torch.where(taken, one, come),
            "give": self.give * given,
            "time": -self.time * s.elapsed,
        }

    def _rest(self, s: Signals) -> Tensor:
        """How the needle has still to move to be near enough to the meeting place ``(n, 3)``, m."""
        way = s.meeting - s.needle_middle
        length = way.norm(dim=-1, keepdim=True).clamp(min=1e-9)
        return way * (1.0 - self.slack / length).clamp(min=0.0)

    def _jaws(self, away: Tensor, opened: Tensor) -> Tensor:
        """How nearly jaws are shut about their pickup point, from 0 to 0.5 ``(n,)``."""
        return 0.2 * torch.exp(-self.gap_rate * away) + 0.3 * (1.0 - opened) * (away == 0)

    def _closeness(self, a: Tensor, b: Tensor) -> Tensor:
        return torch.exp(-self.rate * distance(a, b))


def _away(s: Signals, arm: int) -> Tensor:
    """Distance of an arm's pickup point from the gap between its blades ``(n,)``, m."""
    names = f"psm{arm}_wrist_pos", f"psm{arm}_tool_quat", f"psm{arm}_jaw", f"pickup_{arm}"
    wrist, quat, jaw, pickup = (getattr(s, name) for name in names)
    return outside_jaws(wrist, quat, jaw, pickup.unsqueeze(1)).squeeze(1)
