"""The PSM as the robot of a task: control, grasps, signals, and its description for prompts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.scene.signals import Sensor, Signal, command, of_body, of_joints, of_site, touch
from needlehoop.tasks.contract import Memory, Part, Robot, Weld
from needlehoop.tasks.layout import Arm, ArmEpisode, ToolEpisode, lengths, millimetres
from needlehoop.tasks.start import Chance, Start

_TOOL_SIGNALS = {
    "tool_midpoint": of_site("position", "tool_midpoint", "point between the jaws' tips"),
    "tool_quat": of_site(
        "orientation",
        "tool",
        "tool frame: x along the jaws' hinge, y the way they open, z from the hinge to their tips",
    ),
    "wrist_pos": of_body("position", "wrist_yaw", "wrist-yaw joint"),
    "wrist_quat": of_body("orientation", "wrist_yaw", "wrist-yaw link"),
}

_TENDON = Sensor(mujoco.mjtSensor.mjSENS_TENDONPOS, mujoco.mjtObj.mjOBJ_TENDON, "jaw")
_JAW_MEANING = "angle between the jaws, 0 where they are closed"

JOINT_SIGNALS = {
    "joints": of_joints(psm.JOINT_NAMES, "rad, m", ", ".join(psm.JOINT_NAMES)),
    "jaw": Signal((), "rad", "joint", "sensor", _JAW_MEANING, (_TENDON,)),
}


def _table(things: Mapping[str, Signal], held: str | None) -> dict[str, Signal]:
    """A task's signals with the arm's own, and its jaws' touches of what they hold."""
    touches = {
        f"jaw_{side}_touch": touch(f"jaw_{side}_pad", held, f"{word} jaw touches the {held}")
        for side, word in ((1, "first"), (2, "second"))
        if held
    }
    jaw_command = command("rad", "commanded angle between the jaws")
    return {**_TOOL_SIGNALS, **things, **JOINT_SIGNALS, **touches, "jaw_command": jaw_command}


def tool_start(layout: Arm, chance: Chance) -> dict[str, Tensor]:
    """The robot of a ``Start``: the tool somewhere in its range, roll and jaw nominal."""
    tool = chance.place(layout.tool_position, layout.tool_position_range)
    roll, jaw = (tool.new_full((len(tool),), x) for x in (layout.tool_roll, layout.tool_jaw))
    return start_of(layout, tool, roll, jaw)


def start_of(layout: Arm, tool: Tensor, roll: Tensor, jaw: Tensor) -> dict[str, Tensor]:
    """The robot of a ``Start``: ``tool_midpoint`` at a place ``(n, 3)``, m, the wrist straight.

    ``roll`` about the instrument and the jaws' angle ``(n,)``, rad.
    """
    return {"tool": tool, "joints": _tip_joints(layout, tool, roll), "jaw": jaw}


def servos(robot: Mapping[str, Tensor]) -> Tensor:
    """Commands ``(n, 7)`` for ``joints`` ``(n, 6)``, rad and m, and ``jaw`` ``(n,)``, rad."""
    return torch.cat((robot["joints"], robot["jaw"].unsqueeze(-1)), -1)


def act(
    layout: Arm, rules: ToolEpisode, memory: Memory, action: Tensor
) -> tuple[dict[str, Tensor], Tensor]:
    """Move the targets by an action in [-1, 1].

    Returns:
        The robot's memory: ``target`` ``(n, 3)`` for ``tool_midpoint``, m; ``tool_roll`` ``(n,)``
        about the instrument, rad; ``quat`` ``(n, 4)`` of the tool frame in the remote centre's
        frame (``control=pose``); ``joints`` ``(n, 6)`` and ``jaw`` ``(n,)`` as commanded. And the
        servos' commands ``(n, 7)``: six joints (rad, m) and the jaw.
    """
    target = layout.clamp(memory["target"] + rules.translation * action[:, :3])
    jaw = memory["jaw"] + rules.jaw * action[:, -1]
    jaw = jaw.clamp(layout.jaw_closed, layout.jaw_open)
    roll, quat = memory["tool_roll"], memory["quat"]
    if rules.control == "tip":
        middle, half = layout.tool_roll, layout.roll_range
        roll = (roll + rules.rotation * action[:, 3]).clamp(middle - half, middle + half)
        joints = _tip_joints(layout, target, roll)
    else:
        turn = geo.from_rotation_vector(rules.rotation * action[:, 3:6])
        near = _pose_joints(layout, target, geo.multiply(turn, quat), memory["joints"])
        # The target is what the joints can do: it never runs ahead of their limits. The second
        # pass brings the tip back from where an unreachable turn pulled it.
        quat = _tool_quat(near)
        joints = _pose_joints(layout, target, quat, near)
    moved = {"target": target, "tool_roll": roll, "quat": quat, "joints": joints, "jaw": jaw}
    return moved, servos(moved)


def _tip_joints(layout: Arm, tool: Tensor, roll: Tensor) -> Tensor:
    """Joints ``(n, 6)`` that bring ``tool_midpoint`` to ``tool`` ``(n, 3)``, the wrist straight.

    ``roll`` ``(n,)`` about the instrument, rad; m, world frame. Clamped to the joints' limits.
    """
    joints = psm.straight_wrist(_from_rcm(layout, tool), roll, layout.grip)
    return joints.clamp(*psm.joint_limits(joints.device))


def _from_rcm(layout: Arm, place: Tensor) -> Tensor:
    """Places ``(n, 3)``, m, in the remote centre's frame."""
    away = place - place.new_tensor(layout.rcm)
    if not layout.tilt:
        return away
    half = -layout.tilt / 2
    return geo.rotate(away.new_tensor((np.cos(half), 0.0, np.sin(half), 0.0)), away)


def _pose_joints(layout: Arm, tool: Tensor, quat: Tensor, nearby: Tensor) -> Tensor:
    """Joints ``(n, 6)`` for ``tool_midpoint`` and the tool frame's orientation ``quat`` ``(n, 4)``.

    Found from the joints ``nearby`` ``(n, 6)``. ``tool`` in m, world frame; ``quat`` in the remote
    centre's frame.
    """
    pose = tool.new_zeros(len(tool), 4, 4)
    pose[:, :3, :3] = geo.to_matrix(quat)
    pose[:, :3, 3] = _from_rcm(layout, tool) - layout.grip * pose[:, :3, 2]
    return psm.inverse_kinematics(pose, nearby, iterations=4)


def _tool_quat(joints: Tensor) -> Tensor:
    """Orientation ``(n, 4)`` of the tool frame in the remote centre's."""
    # Imported where the wrist is turned: see ``psm``.
    from pytorch_kinematics import matrix_to_quaternion

    return matrix_to_quaternion(psm.forward_kinematics(joints)[:, :3, :3])


def displaced(
    layout: Arm, rules: ToolEpisode, memory: Mapping[str, Tensor], offset: Tensor
) -> Tensor:
    """Commands ``(n, 7)`` that put the tip ``offset`` ``(n, 3)`` m beside its target."""
    target = memory["target"] + offset
    if rules.control == "tip":
        joints = _tip_joints(layout, target, memory["tool_roll"])
    else:
        joints = _pose_joints(layout, target, memory["quat"], memory["joints"])
    return servos({"joints": joints, "jaw": memory["jaw"]})


def begin(rules: ToolEpisode, robot: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The arm's memory where it starts: targets where the tool is."""
    tool, joints, jaw = (robot[name].clone() for name in ("tool", "joints", "jaw"))
    quat = _tool_quat(joints) if rules.control == "pose" else joints.new_zeros(len(joints), 4)
    roll = joints[:, 3].clone()
    return {"target": tool, "tool_roll": roll, "quat": quat, "joints": joints, "jaw": jaw}


def model(layout: Arm, variant: str) -> mujoco.MjSpec:
    """One of ``psm.VARIANTS`` where the layout says that it stands."""
    return psm.model_spec(variant, layout.rcm, layout.grip, layout.tilt)


def _poser(model: mujoco.MjModel) -> Callable[[np.ndarray, Start], None]:
    put = psm.poser(model)
    return lambda qpos, start: put(qpos, start.robot["joints"].numpy(), start.robot["jaw"].numpy())


ROBOT = Robot(
    model=model,
    poser=_poser,
    begin=lambda rules, start: begin(rules, start.robot),
    act=act,
    table=_table,
    commands={"jaw_command": "jaw"},
    body="psm_base",
    proprio=("joints", "jaw", "jaw_command"),
    displaced=displaced,
    parts={"roll": Part("the instrument's shaft", (0.0, 0.0, 1.0))},
    opens=(-1,),
    label="dvrk_psm",
    tool="large_needle_driver",
    actions={
        "tip": ("x", "y", "z", "turn", "jaw"),
        "pose": ("x", "y", "z", "turn_x", "turn_y", "turn_z", "jaw"),
    },
)


def add_grasp(
    spec: mujoco.MjSpec, rules: ArmEpisode, body: str, prefix: str = "", **softness: Sequence[float]
) -> None:
    """Add what ``episode.grasp`` holds a body with; the arm's names begin with ``prefix``.

    ``weld``: the inactive weld ``<prefix>grasp`` of the wrist with it, of this ``softness``
    (MuJoCo's ``solref`` and ``solimp``). ``friction``: MuJoCo's pass against slip.
    """
    if rules.grasp == "friction":
        # Without it, what is held creeps by 0.66 mm a second.
        spec.option.noslip_iterations = 3
        return
    spec.add_equality(
        name=f"{prefix}grasp",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=f"{prefix}wrist_yaw",
        name2=body,
        active=False,
        **softness,
    )


def hold(
    rules: ArmEpisode,
    memory: Memory,
    readings: Mapping[str, Tensor],
    points: Tensor,
    position: Tensor,
    quat: Tensor,
) -> tuple[Tensor, dict[str, Weld]]:
    """Whether a thing is held, ``(n,)`` bool, and the weld.

    A grasp begins where the thing is between the blades, both touch it, and it keeps them open
    wider than commanded. So shut jaws that stand on it hold nothing.

    Args:
        memory: after the action; ``grasped`` says what was held before.
        points: inside the thing ``(n, k, 3)``, world frame, m.
        position: of the welded body ``(n, 3)``, m.
        quat: of it ``(n, 4)``.
    """
    touch_1, touch_2, command = readings["jaw_1_touch"], readings["jaw_2_touch"], memory["jaw"]
    kept = memory["grasped"] & (command < rules.release_above)
    if rules.grasp == "friction":
        kept = kept & (touch_1 | touch_2)
    stopped = touch_1 & touch_2 & (readings["jaw"] > command)
    caught = ~kept & stopped & (command < rules.close_below)
    # Points are many, and steps in which something may be grasped are few.
    if bool(caught.any()):
        blades = (readings["wrist_pos"], readings["tool_quat"], readings["jaw"])
        caught = caught & (outside_jaws(*blades, points) == 0).any(1)
    held = kept | caught
    if rules.grasp == "friction":
        return held, {}
    inverse = geo.conjugate(readings["wrist_quat"])
    place = geo.rotate(inverse, position - readings["wrist_pos"])
    pose = torch.cat((place, geo.multiply(inverse, quat)), -1)
    return held, {"grasp": Weld(held != memory["grasped"], held, pose)}


def outside_jaws(wrist: Tensor, tool_quat: Tensor, jaw: Tensor, points: Tensor) -> Tensor:
    """Distances ``(n, k)``, m, of points ``(n, k, 3)`` from the gap between the blades; 0 in it.

    ``wrist`` ``(n, 3)``, m; ``tool_quat`` ``(n, 4)``; ``jaw`` ``(n,)``, rad: as in the signals. The
    gap is taken as a box.
    """
    away = points - wrist.unsqueeze(1)
    x, y, z = geo.rotate(geo.conjugate(tool_quat).unsqueeze(1), away).unbind(-1)
    half_gap = torch.sin(jaw / 2).unsqueeze(-1) * psm.JAW_LENGTH
    aside = ((x.abs() - psm.JAW_WIDTH / 2).clamp(min=0), (y.abs() - half_gap).clamp(min=0))
    along = (z - psm.JAW_LENGTH).clamp(min=0) + (-z).clamp(min=0)
    return torch.sqrt(aside[0] ** 2 + aside[1] ** 2 + along**2)


def arm_values(layout: Arm, rules: ToolEpisode) -> dict[str, object]:
    """``control``, ``jaw_closed``, ``jaw_open``, ``jaw_start``, and ``lengths`` of the layout."""
    axes = "each axis of its arm's base" if layout.tilt else "each of them"
    turned_about = {"tip": "its own axis", "pose": axes}[rules.control]
    return {
        **lengths(layout),
        "control": f"moves the tip of the instrument by up to {millimetres(rules.translation)} mm"
        f" along each of x, y and z, turns it by up to {rules.rotation:g} rad about"
        f" {turned_about}, and opens or closes the jaws by up to {rules.jaw:g} rad",
        "jaw_closed": f"{layout.jaw_closed:g}",
        "jaw_open": f"{layout.jaw_open:g}",
        "jaw_start": f"{layout.tool_jaw:g}",
    }


def grasped(rules: ArmEpisode, part: str, command: str = "jaw_command") -> str:
    """In words: when the jaws that a ``command`` moves hold a thing by its ``part``."""
    opened = f"{command} rises above {rules.release_above:g} rad"
    ends = {
        "weld": f"it stays so, without flicker, until {opened}.",
        "friction": f"it becomes false when neither touches it any more, or when {opened}, and may"
        " flicker.",
    }
    return (
        f"becomes true when {part} is between the jaws, both touch it and it keeps them from"
        f" closing further, while {command} is below {rules.close_below:g} rad; {ends[rules.grasp]}"
    )
