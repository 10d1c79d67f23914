"""A robot of one's own: a gantry with a gripper, from plain MJCF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.tasks.contract import Memory, Robot
from needlehoop.tasks.start import Start

PREFIX = "gantry_"
"""Of the names in ``gantry.xml``, once they are in the scene."""

JOINTS = ("x", "y", "z", "finger_1", "finger_2")
"""In the order of the servos; a finger's joint is 0 where the gripper is closed."""


def add(spec: mujoco.MjSpec, layout: Any, psm: str) -> None:
    """Add the gantry; there is one variant of it."""
    gantry = mujoco.MjSpec.from_file(str(Path(__file__).with_name("gantry.xml")))
    spec.attach(gantry, prefix=PREFIX, frame=spec.worldbody.add_frame())


def poser(model: mujoco.MjModel) -> Callable[[np.ndarray, Start], None]:
    """What writes the hand's place and the gripper's opening into ``qpos`` ``(k, nq)``."""
    columns = [int(model.joint(PREFIX + name).qposadr[0]) for name in JOINTS]

    def write(qpos: np.ndarray, start: Start) -> None:
        qpos[:, columns] = start.control.numpy()

    return write


def act(
    layout: Any, rules: Any, memory: Memory, action: Tensor
) -> tuple[dict[str, Tensor], Tensor]:
    """Move the hand's target by three numbers and the opening's by the fourth."""
    lower = torch.tensor(layout.workspace_lower, dtype=torch.float64)
    upper = torch.tensor(layout.workspace_upper, dtype=torch.float64)
    tool = (memory["tool"] + rules.translation * action[:, :3]).clamp(lower, upper)
    opening = (memory["opening"] + rules.grip * action[:, 3]).clamp(0.0, layout.open)
    return {"tool": tool, "opening": opening}, servos(tool, opening)


def servos(tool: Tensor, opening: Tensor) -> Tensor:
    """Commands ``(n, 5)`` from the tool's place ``(n, 3)`` and the opening ``(n,)``, m."""
    return torch.cat((tool, torch.stack((opening, opening), -1)), -1)


ROBOT = Robot(
    add=add,
    poser=poser,
    begin=lambda rules, start: {name: value.clone() for name, value in start.robot.items()},
    act=act,
    commands=lambda memory: {"grip_command": memory["opening"]},
    materials={},
    body=f"{PREFIX}base",
    proprio=("tool", "grip", "grip_command"),
    opens=3,
)
