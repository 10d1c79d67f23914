"""Who can do it: a script that sees signals, acts as agents do, and remembers nothing."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from needlehoop.robot.geometry import aside, distance, ramp
from needlehoop.tasks.contract import Controller

_HOVER = 0.02
"""Height above the table at which the hand and the cube travel, m."""


def expert(layout: Any, rules: Any) -> Controller:
    """Above the cube, down, close, up, above the spot, down, open, up."""

    def act(s: Any) -> Tensor:
        high, away = s.cube[:, 2] - layout.cube / 2, aside(s.cube - s.spot)
        done = (away < 0.6 * rules.spot_radius) & (high < 0.001)
        around = distance(s.tool, s.cube) < 0.003
        # Ramps and not switches, where a learner sees places to 2 or 3 mm.
        pick, carry, leave = s.cube - s.tool, s.spot - s.cube, torch.zeros_like(s.tool)
        pick[:, 2] += _HOVER * ramp(aside(pick), 0.003, 0.008)
        free = torch.maximum(ramp(high, 0.005, 0.012), (away < 0.006).double())
        carry[:, :2] *= free.unsqueeze(-1)
        carry[:, 2] = _HOVER * ramp(away, 0.002, 0.006) - high
        leave[:, 2] = torch.where(s.grip > 0.004, _HOVER, 0.0)
        move = torch.where(s.held.unsqueeze(-1), carry, pick)
        move = torch.where(done.unsqueeze(-1), leave, move)
        grip = torch.where(around & ~done, -1.0, 1.0).unsqueeze(-1)
        return torch.cat(((0.5 * move / rules.translation).clamp(-1, 1), grip), -1)

    return act
