"""A robot of one's own: a gantry with a gripper, from plain MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import torch
from torch import Tensor

from needlehoop.scene.signals import Signal, command, of_joints, of_site, touch
from needlehoop.tasks.contract import Memory, Robot


def act(layout: Any, rules: Any, memory: Memory, action: Tensor) -> tuple[dict, Tensor]:
    """Move the hand's target by three numbers and the opening's by the fourth."""
    tool = layout.clamp(memory["tool"] + rules.translation * action[:, :3])
    opening = (memory["opening"] + rules.grip * action[:, 3]).clamp(0.0, layout.open)
    return {"tool": tool, "opening": opening}, servos(tool, opening)


def servos(tool: Tensor, opening: Tensor) -> Tensor:
    """Commands ``(n, 5)`` for x, y, z and both fingers, from a place ``(n, 3)`` and ``(n,)``, m."""
    return torch.cat((tool, torch.stack((opening, opening), -1)), -1)


def table(things: Mapping[str, Signal], held: str | None) -> dict[str, Signal]:
    """What the gantry senses about what a task does, and its fingers' touches of a body."""
    return {
        "tool": of_site("position", "tool", "middle between the fingers"),
        **things,
        "grip": of_joints(["finger_1"], "m", "opening of a finger, 0 where it is closed"),
        "finger_1_touch": touch("pad_1", str(held), f"first finger touches the {held}"),
        "finger_2_touch": touch("pad_2", str(held), f"second finger touches the {held}"),
        "grip_command": command("m", "commanded opening of a finger"),
    }


ROBOT = Robot(
    model=lambda layout, psm: mujoco.MjSpec.from_file(str(Path(__file__).with_name("gantry.xml"))),
    act=act,
    table=table,
    commands={"grip_command": "opening"},
    body="base",
    proprio=("tool", "grip", "grip_command"),
    opens=(3,),
)
