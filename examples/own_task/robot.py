"""A robot of one's own: a gantry with a gripper, from plain MJCF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import torch
from torch import Tensor

from needlehoop.tasks.contract import Memory, Robot


def act(layout: Any, rules: Any, memory: Memory, action: Tensor) -> tuple[dict, Tensor]:
    """Move the hand's target by three numbers and the opening's by the fourth."""
    tool = layout.clamp(memory["tool"] + rules.translation * action[:, :3])
    opening = (memory["opening"] + rules.grip * action[:, 3]).clamp(0.0, layout.open)
    return {"tool": tool, "opening": opening}, servos(tool, opening)


def servos(tool: Tensor, opening: Tensor) -> Tensor:
    """Commands ``(n, 5)`` for x, y, z and both fingers, from a place ``(n, 3)`` and ``(n,)``, m."""
    return torch.cat((tool, torch.stack((opening, opening), -1)), -1)


ROBOT = Robot(
    model=lambda layout, psm: mujoco.MjSpec.from_file(str(Path(__file__).with_name("gantry.xml"))),
    act=act,
    commands=lambda memory: {"grip_command": memory["opening"]},
    body="base",
    proprio=("tool", "grip", "grip_command"),
    opens=3,
)
