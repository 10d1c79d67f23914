"""Where a ``Start`` goes in MuJoCo's state: addresses into qpos, mocap and ctrl."""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop.robot.parallelogram import Posture
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
        self._qpos0 = model.qpos0.copy()
        self._posture = Posture(model)
        self._needle = int(model.joint("needle").qposadr[0])
        mocap = {
            name: int(model.body(name).mocapid[0]) for name in ("stand", "hoop", "lift_position")
        }
        self._stand, self._hoop, self._lift = mocap.values()
        self._nmocap = model.nmocap

    def qpos(self, start: Start) -> np.ndarray:
        """Generalised positions ``(k, nq)``."""
        qpos = np.tile(self._qpos0, (len(start), 1))
        self._posture.write(qpos, start.joints.numpy(), start.jaw.numpy())
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
