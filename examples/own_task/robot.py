"""A robot of one's own: a gantry with a gripper, from plain MJCF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from needlehoop.scene.spec import attach
from needlehoop.tasks.contract import Memory, Robot

PREFIX = "gantry_"
"""Of the names in ``gantry.xml``, once they are in the scene."""


def act(layout: Any, rules: Any, memory: Memory, action: Tensor) -> tuple[dict, Tensor]:
    """Move the hand's target by three numbers and the opening's by the fourth."""
    tool = layout.clamp(memory["tool"] + rules.translation * action[:, :3])
    opening = (memory["opening"] + rules.grip * action[:, 3]).clamp(0.0, layout.open)
    return {"tool": tool, "opening": opening}, servos(tool, opening)


def servos(tool: Tensor, opening: Tensor) -> Tensor:
    """Commands ``(n, 5)`` for x, y, z and both fingers, from a place ``(n, 3)`` and ``(n,)``, m."""
    return torch.cat((tool, torch.stack((opening, opening), -1)), -1)


ROBOT = Robot(
    add=lambda spec, layout, psm: attach(spec, Path(__file__).with_name("gantry.xml"), PREFIX),
    act=act,
    commands=lambda memory: {"grip_command": memory["opening"]},
    body=f"{PREFIX}base",
    proprio=("tool", "grip", "grip_command"),
    opens=3,
)
