"""Where a ``Start`` goes in MuJoCo's state: addresses into qpos, mocap and ctrl."""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop.robot.parallelogram import linkage_ratios
from needlehoop.robot.psm import JOINT_NAMES
from needlehoop.task.start import Start

WELD = "grasp"
"""Name of the equality that a weld grasp switches."""


STATE = (
    "time",
    "qpos",
    "qvel",
    "qacc_warmstart",
    "ctrl",
    "mocap_pos",
    "mocap_quat",
    "eq_active",
)
"""What the scene's physics depends on: it has no activations, and nothing applies forces."""


class Addresses:
    """Writes starts into state arrays of a compiled scene.

    Args:
        model: the scene.
    """

    def __init__(self, model: mujoco.MjModel):
        def qpos_address(name: str) -> int:
            return int(model.joint(name).qposadr[0])

        self._qpos0 = model.qpos0.copy()
        self._joints = [qpos_address(name) for name in JOINT_NAMES]
        self._jaws = [qpos_address("jaw_1"), qpos_address("jaw_2")]
        self._needle = qpos_address("needle")
        self._linkage = {qpos_address(name): r for name, r in linkage_ratios(model).items()}
        self._pitch = JOINT_NAMES.index("pitch")
        mocap = {
            name: int(model.body(name).mocapid[0]) for name in ("stand", "hoop", "lift_position")
        }
        self._stand, self._hoop, self._lift = mocap.values()
        self._nmocap = model.nmocap

    def qpos(self, start: Start) -> np.ndarray:
        """Generalised positions ``(k, nq)``."""
        qpos = np.tile(self._qpos0, (len(start), 1))
        joints, jaw = start.joints.numpy(), start.jaw.numpy()
        qpos[:, self._joints] = joints
        for address, ratio in self._linkage.items():
            qpos[:, address] = ratio * joints[:, self._pitch]
        qpos[:, self._jaws[0]], qpos[:, self._jaws[1]] = jaw / 2, -jaw / 2
        qpos[:, self._needle : self._needle + 7] = start.needle.numpy()
        return qpos

    def mocap(self, start: Start) -> np.ndarray:
        """Positions of the mocap bodies ``(k, nmocap, 3)``; they are never turned."""
        mocap = np.zeros((len(start), self._nmocap, 3))
        mocap[:, self._stand, :2] = start.hoop[:, :2].numpy()
        mocap[:, self._hoop] = start.hoop.numpy()
        mocap[:, self._lift] = start.lift.numpy()
        return mocap

    def control(self, start: Start) -> np.ndarray:
        """Servo commands ``(k, 7)`` that hold the start."""
        return np.concatenate((start.joints.numpy(), start.jaw[:, None].numpy()), -1)


def weld_index(model: mujoco.MjModel) -> int | None:
    """Which equality a grasp switches; none where grasps are left to friction."""
    names = [model.equality(i).name for i in range(model.neq)]
    return names.index(WELD) if WELD in names else None


def weld_data(pose: np.ndarray) -> np.ndarray:
    """The first ten numbers of a weld's ``eq_data`` for relative poses ``(k, 7)``.

    Anchor in the needle (its origin), the same point in the wrist, relative quaternion.
    """
    return np.concatenate((np.zeros((len(pose), 3)), pose), -1)
