"""Where the arm's joint positions stand in qpos."""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop.robot.joints import JOINT_NAMES
from needlehoop.robot.parallelogram import linkage_ratios

_PITCH = JOINT_NAMES.index("pitch")


class Posture:
    """Writes postures of the arm into generalised positions.

    Args:
        model: a compiled model with the arm in it.
    """

    def __init__(self, model: mujoco.MjModel):
        def address(name: str) -> int:
            return int(model.joint(name).qposadr[0])

        self._joints = [address(name) for name in JOINT_NAMES]
        self._jaws = [address("jaw_1"), address("jaw_2")]
        self._linkage = {address(name): ratio for name, ratio in linkage_ratios(model).items()}

    def write(self, qpos: np.ndarray, joints: np.ndarray, jaw: np.ndarray) -> None:
        """Put the arm, its linkage closed, into ``qpos`` ``(k, nq)``.

        ``joints`` ``(k, 6)`` in the order of ``psm.JOINTS``, rad and m; ``jaw`` ``(k,)``, rad.
        """
        qpos[:, self._joints] = joints
        for address, ratio in self._linkage.items():
            qpos[:, address] = ratio * joints[:, _PITCH]
        qpos[:, self._jaws[0]], qpos[:, self._jaws[1]] = jaw / 2, -jaw / 2
