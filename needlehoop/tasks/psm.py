"""The PSM as the robot of a task: how actions move it, its sensors and signals."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot.arm import add_arm
from needlehoop.robot.joints import JOINT_NAMES
from needlehoop.robot.parallelogram import Posture
from needlehoop.scene.signals import SensorSpec, Signal
from needlehoop.scene.spec import Materials, begin_spec
from needlehoop.tasks.arm_kinematics import pose_joints, tip_joints, tool_quat
from needlehoop.tasks.contract import Memory, Robot
from needlehoop.tasks.episode import ToolEpisode
from needlehoop.tasks.layout import ArmLayout
from needlehoop.tasks.start import Start

_SENS, _OBJ = mujoco.mjtSensor, mujoco.mjtObj

TOOL_SENSORS = {
    "tool_midpoint": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_SITE, "tool_midpoint"),
    "tool_quat": SensorSpec(_SENS.mjSENS_FRAMEQUAT, _OBJ.mjOBJ_SITE, "tool"),
    "wrist_pos": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_XBODY, "wrist_yaw"),
    "wrist_quat": SensorSpec(_SENS.mjSENS_FRAMEQUAT, _OBJ.mjOBJ_XBODY, "wrist_yaw"),
}

JOINT_SENSORS = {
    **{
        name: SensorSpec(_SENS.mjSENS_JOINTPOS, _OBJ.mjOBJ_JOINT, name, signal="joints")
        for name in JOINT_NAMES
    },
    "jaw": SensorSpec(_SENS.mjSENS_TENDONPOS, _OBJ.mjOBJ_TENDON, "jaw"),
}

TOOL_SIGNALS = {
    "tool_midpoint": Signal((3,), "m", "world", "sensor", "point between the jaws' tips"),
    "tool_quat": Signal(
        (4,),
        "1",
        "world",
        "sensor",
        "tool frame: x along the jaws' hinge, y the way they open, z from the hinge to their tips",
    ),
    "wrist_pos": Signal((3,), "m", "world", "sensor", "wrist-yaw joint"),
    "wrist_quat": Signal((4,), "1", "world", "sensor", "wrist-yaw link"),
}

JOINT_SIGNALS = {
    "joints": Signal((6,), "rad, m", "joint", "sensor", ", ".join(JOINT_NAMES)),
    "jaw": Signal((), "rad", "joint", "sensor", "angle between the jaws, 0 where they are closed"),
}

JAW_COMMAND = Signal((), "rad", "joint", "command", "commanded angle between the jaws")

_MATERIALS: Materials = {
    "arm_light": ((0.80, 0.81, 0.83), 0.3, 0.4),
    "arm_dark": ((0.27, 0.29, 0.33), 0.3, 0.4),
    "instrument": ((0.50, 0.53, 0.60), 0.3, 0.4),
    "shaft": ((0.15, 0.15, 0.17), 0.5, 0.6),
    "steel": ((0.58, 0.60, 0.64), 0.8, 0.6),
    "jaw": ((0.73, 0.75, 0.79), 0.9, 0.7),
}


def touch_sensors(body: str) -> dict[str, SensorSpec]:
    """Sensors that say whether each jaw's pad touches a body."""
    return {
        f"jaw_{side}_touch": SensorSpec(
            _SENS.mjSENS_CONTACT, _OBJ.mjOBJ_GEOM, f"jaw_{side}_pad", body
        )
        for side in (1, 2)
    }


def start_of(layout: ArmLayout, tool: Tensor, roll: Tensor, jaw: Tensor) -> dict[str, Tensor]:
    """The robot of a ``Start``: the tool at a place, the wrist straight.

    Args:
        layout: where the arm stands.
        tool: ``tool_midpoint`` ``(n, 3)``, m, world frame.
        roll: about the instrument ``(n,)``, rad.
        jaw: angle ``(n,)``, rad.
    """
    joints = tip_joints(layout, tool, roll)
    return {"tool": tool, "joints": joints, "jaw": jaw}


def servos(robot: dict[str, Tensor]) -> Tensor:
    """Commands ``(n, 7)`` that hold the robot of a ``Start``: six joints (rad, m) and the jaw."""
    return torch.cat((robot["joints"], robot["jaw"].unsqueeze(-1)), -1)


def build_arm(layout: ArmLayout, psm: str) -> mujoco.MjSpec:
    """The arm alone, ready to compile; its RCM is the world's origin.

    Args:
        layout: the physics' step, and where ``tool_midpoint`` is.
        psm: arm variant, see ``arm.VARIANTS``.
    """
    spec = begin_spec("psm", layout.timestep, _MATERIALS)
    add_arm(spec, np.zeros(3), psm, layout.grip)
    # All of it, from the tip to the motors.
    spec.stat.extent = 1.0
    spec.stat.center = [0.0, 0.35, 0.15]
    return spec


def act(
    layout: ArmLayout, rules: ToolEpisode, memory: Memory, action: Tensor
) -> tuple[dict[str, Tensor], Tensor]:
    """Move the targets by an action in [-1, 1] and turn them into servo commands.

    Args:
        layout: workspace and limits that clamp the target.
        rules: control mode and action scales.
        memory: ``target`` ``(n, 3)`` for ``tool_midpoint``, m; ``tool_roll`` ``(n,)`` about the
            instrument, rad; ``quat`` ``(n, 4)`` of the tool frame (``control=pose``); ``joints``
            ``(n, 6)`` and ``jaw`` ``(n,)`` as commanded.
        action: ``(n, action_size)`` float64.

    Returns:
        The same five, moved; and the servos' commands ``(n, 7)``: the six joints (rad, m)
        and the jaw (rad).
    """
    lower = torch.tensor(layout.workspace_lower, dtype=torch.float64)
    upper = torch.tensor(layout.workspace_upper, dtype=torch.float64)
    target = (memory["target"] + rules.translation * action[:, :3]).clamp(lower, upper)
    jaw = memory["jaw"] + rules.jaw * action[:, -1]
    jaw = jaw.clamp(layout.jaw_closed, layout.jaw_open)
    roll, quat = memory["tool_roll"], memory["quat"]
    if rules.control == "tip":
        roll = roll + rules.rotation * action[:, 3]
        roll = roll.clamp(
            layout.tool_roll - layout.roll_range, layout.tool_roll + layout.roll_range
        )
        joints = tip_joints(layout, target, roll)
    else:
        turn = geo.from_rotation_vector(rules.rotation * action[:, 3:6])
        near = pose_joints(layout, target, geo.multiply(turn, quat), memory["joints"])
        # What the joints can do is the target: it never runs ahead of the limits. The
        # second pass brings the tip back from where an unreachable turn pulled it.
        quat = tool_quat(near)
        joints = pose_joints(layout, target, quat, near)
    moved = {"target": target, "tool_roll": roll, "quat": quat, "joints": joints, "jaw": jaw}
    return moved, torch.cat((joints, jaw.unsqueeze(-1)), -1)


def _displaced(
    layout: ArmLayout, rules: ToolEpisode, memory: Memory, control: Tensor, offset: Tensor
) -> Tensor:
    """Commands ``(n, 7)`` that put the tip ``offset`` ``(n, 3)`` m beside its target."""
    target = memory["target"] + offset
    if rules.control == "tip":
        joints = tip_joints(layout, target, memory["tool_roll"])
    else:
        joints = pose_joints(layout, target, memory["quat"], memory["joints"])
    return torch.cat((joints, control[:, -1:]), -1)


def _begin(rules: ToolEpisode, start: Start) -> dict[str, Tensor]:
    """Targets where the tool is."""
    robot = start.robot
    joints = robot["joints"]
    return {
        "target": robot["tool"].clone(),
        "tool_roll": joints[:, 3].clone(),
        "quat": tool_quat(joints) if rules.control == "pose" else torch.zeros(len(joints), 4),
        "joints": joints.clone(),
        "jaw": robot["jaw"].clone(),
    }


def _poser(model: mujoco.MjModel) -> Callable[[np.ndarray, Start], None]:
    posture = Posture(model)

    def write(qpos: np.ndarray, start: Start) -> None:
        posture.write(qpos, start.robot["joints"].numpy(), start.robot["jaw"].numpy())

    return write


ROBOT = Robot(
    add=lambda spec, layout, psm: add_arm(spec, layout.rcm, psm, layout.grip),
    poser=_poser,
    begin=_begin,
    act=act,
    commands=lambda memory: {"jaw_command": memory["jaw"]},
    materials=_MATERIALS,
    body="psm_base",
    proprio=("joints", "jaw", "jaw_command"),
    displaced=_displaced,
    opens=-1,
)
