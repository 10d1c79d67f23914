"""The da Vinci patient-side manipulator (PSM): constants, kinematics and the MuJoCo model.

Frames. The remote centre of motion (RCM) is the point where the yaw, pitch and
insertion axes meet. In the RCM frame z points up, and with all joints at zero the
instrument hangs along -z. The *tool frame* sits at the wrist-yaw joint, turned by the
tool-tip offset: z along the jaws, x along the axis the jaws turn about.

Sources: jhu-dvrk/sawIntuitiveResearchKit ``share/kinematic/PSM.json`` and
``share/tool/LARGE_NEEDLE_DRIVER_400006.json`` (Denavit-Hartenberg rows, limits).
Modified (Craig) convention throughout.

The model is plain MJCF, ``mjcf/<variant>.xml``. Every body's frame is its joint's, so the compiled
model and ``forward_kinematics`` are one chain. ``README.md`` says where its numbers are from.

Kinematics are pytorch-kinematics', which is imported at the first call: it is slow to import, and
``straight_wrist`` does not need it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import mujoco
import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    import pytorch_kinematics as pk

Joints = TypeVar("Joints", Tensor, np.ndarray)

VARIANTS = ("serial", "parallelogram")
"""How the arm pitches: one link about the remote centre, or the closed linkage."""


@dataclass(frozen=True)
class Joint:
    """One row of the modified DH table, with the joint's limits. Lengths in m, angles in rad."""

    name: str
    prismatic: bool
    alpha: float
    a: float
    d: float
    theta: float
    lower: float
    upper: float


JOINTS = (
    Joint("yaw", False, pi / 2, 0.0, 0.0, pi / 2, -1.588, 1.588),
    Joint("pitch", False, -pi / 2, 0.0, 0.0, -pi / 2, -0.925, 0.925),
    Joint("insertion", True, pi / 2, 0.0, -0.4318, 0.0, 0.0, 0.24),
    Joint("roll", False, 0.0, 0.0, 0.4162, 0.0, -4.538, 4.538),
    Joint("wrist_pitch", False, -pi / 2, 0.0, 0.0, -pi / 2, -1.396, 1.396),
    Joint("wrist_yaw", False, -pi / 2, 0.0091, 0.0, -pi / 2, -1.396, 1.396),
)
JOINT_NAMES = tuple(joint.name for joint in JOINTS)

HOME = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)
"""Joint positions of the arm at rest: hanging, half inserted, rad and m."""

JAW_LENGTH = 0.0102
"""Wrist-yaw axis to the blades' tips, m."""
JAW_WIDTH = 0.005
"""Width of a blade at its root, m."""

WRIST_LENGTH = 0.0091
"""Wrist-pitch axis to wrist-yaw axis, m."""
SHAFT_OFFSET = 0.4318 - 0.4162
"""Insertion at which the wrist-pitch axis is in the RCM, m."""

TOOL_OFFSET = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
"""Tool-tip offset: the tool frame's axes (columns) in the wrist-yaw frame."""


def model_spec(variant: str, rcm: np.ndarray, grip: float, tilt: float = 0.0) -> mujoco.MjSpec:
    """The arm, ready for a scene about it.

    Bodies: ``yaw`` … ``wrist_yaw``, ``jaw_1``, ``jaw_2``. Joints carry the names of ``JOINTS`` and
    ``jaw_1``, ``jaw_2``. Actuators: those six and ``jaw``. Site ``tool_midpoint`` lies between the
    blades.

    Args:
        variant: one of ``VARIANTS``.
        rcm: position of the RCM in the world frame ``(3,)``, m.
        grip: ``tool_midpoint``'s distance from the wrist-yaw axis, m.
        tilt: of the RCM frame about the world's y, rad.
    """
    spec = mujoco.MjSpec.from_file(str(Path(__file__).parent / "mjcf" / f"{variant}.xml"))
    base = spec.body("psm_base")
    base.pos, base.quat = rcm, [np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0]
    spec.site("tool_midpoint").pos = [0.0, grip, 0.0]
    return spec


def poser(
    model: mujoco.MjModel, prefix: str = ""
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    """A function that writes postures of the arm into ``qpos`` ``(k, nq)``, the linkage closed.

    Its arguments are ``qpos``, joint positions ``(k, 6)`` in the order of ``JOINTS``, rad and m,
    and the jaws' angle ``(k,)``, rad. Names of the arm's joints begin with ``prefix``.
    """
    six = [int(model.joint(prefix + name).qposadr[0]) for name in JOINT_NAMES]
    jaw_1 = int(model.joint(f"{prefix}jaw_1").qposadr[0])
    tied = [
        row
        for row in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT)
        if model.equality(row).name.startswith(prefix)
    ]
    ratios = [
        (*model.jnt_qposadr[[model.eq_obj1id[row], model.eq_obj2id[row]]], model.eq_data[row, 1])
        for row in tied
    ]

    def write(qpos: np.ndarray, joints: np.ndarray, jaw: np.ndarray) -> None:
        qpos[:, six], qpos[:, jaw_1] = joints, jaw / 2
        for follower, leader, ratio in ratios:
            qpos[:, follower] = ratio * qpos[:, leader]

    return write


@cache
def _chain(device: torch.device) -> pk.SerialChain:
    """The arm's chain on a device, built frame by frame from the DH rows in float64.

    pytorch-kinematics' own MJCF reader does not know MuJoCo 3.17's joint enum, and
    MjSpec.to_xml rounds to six digits, which would cost a micrometre at the tip.
    """
    import pytorch_kinematics as pk
    from pytorch_kinematics.frame import Frame, Link
    from pytorch_kinematics.frame import Joint as ChainJoint

    offset = partial(pk.Transform3d, dtype=torch.float64)
    child = Frame("tool", link=Link("tool", offset=offset(rot=torch.from_numpy(TOOL_OFFSET))))
    for joint in reversed(JOINTS):
        link = Link(joint.name, offset=offset(matrix=torch.from_numpy(_dh_pose(joint))))
        kind = "prismatic" if joint.prismatic else "revolute"
        parent = Frame(joint.name, link=link, joint=ChainJoint(joint.name, joint_type=kind))
        parent.add_child(child)
        child = parent
    root = Frame("rcm", link=Link("rcm"), joint=ChainJoint())
    root.add_child(child)
    where: Any = {"dtype": torch.float64, "device": str(device)}
    return pk.SerialChain(pk.Chain(root.to(**where), **where), "tool", **where)


def _dh_pose(joint: Joint) -> np.ndarray:
    """Pose ``(4, 4)`` of a joint's frame in its parent's, at position 0."""
    d, cos, sin = joint.d, np.cos, np.sin
    ca, sa, ct, st = cos(joint.alpha), sin(joint.alpha), cos(joint.theta), sin(joint.theta)
    return np.array(
        [
            [ct, -st, 0.0, joint.a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def forward_kinematics(q: Joints) -> Joints:
    """Pose of the tool frame in the RCM frame: an array for an array, a tensor for a tensor.

    Args:
        q: joint positions ``(..., 6)``: yaw, pitch (rad), insertion (m), roll,
            wrist_pitch, wrist_yaw (rad).

    Returns:
        Homogeneous poses ``(..., 4, 4)``, float64, translation in m.

    Raises:
        ValueError: the last dimension is not 6.
    """
    if isinstance(q, np.ndarray):
        return forward_kinematics(torch.as_tensor(q)).numpy()
    if q.shape[-1:] != (len(JOINTS),):
        raise ValueError(
            f"q has shape {tuple(q.shape)}; expected (..., 6): {', '.join(JOINT_NAMES)}"
        )
    flat = q.reshape(-1, len(JOINTS)).to(torch.float64)
    pose = _chain(flat.device).forward_kinematics(flat).get_matrix()
    return pose.reshape(*q.shape[:-1], 4, 4)


def straight_wrist(position: Tensor, roll: Tensor, reach: float) -> Tensor:
    """Joint positions that put a point of a straight-wristed tool at ``position``.

    With the wrist at zero the instrument is a line through the RCM: the direction gives yaw and
    pitch, the distance gives the insertion.

    Args:
        position: target ``(..., 3)`` in the RCM frame, m, below the RCM (z < 0).
        roll: rotation about the instrument's axis ``(...,)``, rad.
        reach: distance of the controlled point from the wrist-yaw axis, m.

    Returns:
        Joint positions ``(..., 6)``, in the order of ``JOINTS``.
    """
    x, y, z = position.unbind(-1)
    in_plane = x * x + z * z
    length = torch.sqrt(in_plane + y * y)
    # Not atan2, whose last bit depends on where in a batch an element stands.
    yaw = torch.atan(x / -z)
    pitch = torch.atan(-y / torch.sqrt(in_plane))
    insertion = length + (SHAFT_OFFSET - WRIST_LENGTH - reach)
    zero = torch.zeros_like(roll)
    return torch.stack((yaw, pitch, insertion, roll, zero, zero), -1)


def inverse_kinematics(
    pose: Tensor, start: Tensor, iterations: int = 8, damping: float = 1e-4
) -> Tensor:
    """Joint positions for a full tool pose, by damped least squares from ``start``.

    Args:
        pose: target pose of the tool frame ``(n, 4, 4)`` in the RCM frame.
        start: joint positions to start from ``(n, 6)``; the nearer, the better.
        iterations: Newton steps; each is clamped to the joint limits.
        damping: squared damping factor, relative to metres and radians alike.

    Returns:
        Joint positions ``(n, 6)`` within the limits, float64. A pose out of reach gives
        the nearest that the iteration found.
    """
    import pytorch_kinematics as pk

    chain, q = _chain(start.device), start.to(torch.float64)
    lower, upper = joint_limits(q.device)
    identity = damping * torch.eye(6, dtype=torch.float64, device=q.device)
    for _ in range(iterations):
        jacobian, now = chain.jacobian(q, ret_eef_pose=True)
        turn = pk.matrix_to_axis_angle(pose[:, :3, :3] @ now[:, :3, :3].mT)
        twist = torch.cat((pose[:, :3, 3] - now[:, :3, 3], turn), -1)
        step = torch.linalg.solve(jacobian @ jacobian.mT + identity, twist.unsqueeze(-1))
        q = torch.clamp(q + (jacobian.mT @ step).squeeze(-1), lower, upper)
    return q


def joint_limits(device: torch.device | None = None) -> tuple[Tensor, Tensor]:
    """Lower and upper limits of the six joints, ``(6,)`` each, rad or m."""
    ends = [(joint.lower, joint.upper) for joint in JOINTS]
    lower, upper = torch.tensor(ends, dtype=torch.float64, device=device).unbind(-1)
    return lower, upper
