"""Where a ``Start`` goes in MuJoCo's state: addresses into qpos, mocap and ctrl."""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop.tasks.contract import Robot
from needlehoop.tasks.start import Start

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
    """Writes starts into state arrays of a compiled scene."""

    def __init__(self, model: mujoco.MjModel, robot: Robot):
        self._qpos0, self._nmocap = model.qpos0.copy(), model.nmocap
        self._pose = robot.poser(model)
        joints = (model.joint(i) for i in range(model.njnt))
        free = int(mujoco.mjtJoint.mjJNT_FREE)
        self._free = {one.name: int(one.qposadr[0]) for one in joints if one.type[0] == free}
        bodies = (model.body(i) for i in range(model.nbody))
        self._mocap = {one.name: int(one.mocapid[0]) for one in bodies if one.mocapid[0] >= 0}
        weld = int(mujoco.mjtEq.mjEQ_WELD)
        equalities = (model.equality(i) for i in range(model.neq))
        self.welds = {one.name: one.id for one in equalities if one.type[0] == weld and one.name}
        """Index of each weld that a task may switch."""

    def state(self, start: Start) -> dict[str, np.ndarray]:
        """Where episodes begin: ``qpos`` ``(k, nq)``, ``mocap_pos`` ``(k, nmocap, 3)``, ``ctrl``.

        ``ctrl`` ``(k, nu)``: servo commands that hold the start. Mocap bodies are never turned.
        """
        qpos = np.tile(self._qpos0, (len(start), 1))
        self._pose(qpos, start)
        for name, pose in start.free.items():
            at = self._free[name]
            qpos[:, at : at + 7] = pose.numpy()
        mocap = np.zeros((len(start), self._nmocap, 3))
        for name, place in start.mocap.items():
            mocap[:, self._mocap[name]] = place.numpy()
        return {"qpos": qpos, "mocap_pos": mocap, "ctrl": start.control.numpy()}
