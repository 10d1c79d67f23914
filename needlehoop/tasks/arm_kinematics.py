"""Where the joints have to be for the tool to be somewhere: the arm's kinematics, in the world."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.tasks.layout import ArmLayout


def tip_joints(layout: ArmLayout, tool: Tensor, roll: Tensor) -> Tensor:
    """Joints ``(n, 6)`` that bring ``tool_midpoint`` to ``tool`` ``(n, 3)``, the wrist straight.

    ``roll`` ``(n,)`` about the instrument, rad; m, world frame. Clamped to the joints' limits.
    """
    joints = psm.straight_wrist(tool - torch.from_numpy(layout.rcm), roll, layout.grip)
    return joints.clamp(*psm.joint_limits())


def pose_joints(layout: ArmLayout, tool: Tensor, quat: Tensor, nearby: Tensor) -> Tensor:
    """Joints ``(n, 6)`` for ``tool_midpoint`` and the tool frame's orientation ``quat`` ``(n, 4)``.

    Found from the joints ``nearby`` ``(n, 6)``; m, world frame.
    """
    pose = torch.zeros(len(tool), 4, 4, dtype=torch.float64)
    pose[:, :3, :3] = geo.to_matrix(quat)
    pose[:, :3, 3] = tool - torch.from_numpy(layout.rcm) - layout.grip * pose[:, :3, 2]
    return psm.inverse_kinematics(pose, nearby, iterations=4)


def tool_quat(joints: Tensor) -> Tensor:
    """Orientation ``(n, 4)`` of the tool frame."""
    # Imported where the wrist is turned: see ``psm``.
    from pytorch_kinematics import matrix_to_quaternion

    return matrix_to_quaternion(psm.forward_kinematics(joints)[:, :3, :3])
