"""Where a ``Start`` goes in MuJoCo's state: addresses into qpos, mocap and ctrl."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from needlehoop.tasks.contract import Robot, Weld
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
    """Writes starts into state arrays of a compiled scene.

    Args:
        model: the scene.
        robot: in it.
    """

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

    def qpos(self, start: Start) -> np.ndarray:
        """Generalised positions ``(k, nq)``."""
        qpos = np.tile(self._qpos0, (len(start), 1))
        self._pose(qpos, start)
        for name, pose in start.free.items():
            at = self._free[name]
            qpos[:, at : at + 7] = pose.numpy()
        return qpos

    def mocap(self, start: Start) -> np.ndarray:
        """Positions of the mocap bodies ``(k, nmocap, 3)``; they are never turned."""
        mocap = np.zeros((len(start), self._nmocap, 3))
        for name, place in start.mocap.items():
            mocap[:, self._mocap[name]] = place.numpy()
        return mocap

    def control(self, start: Start) -> np.ndarray:
        """Servo commands ``(k, nu)`` that hold the start."""
        return start.control.numpy()


def changed_welds(welds: Mapping[str, Weld]) -> dict[str, Weld]:
    """Those that change in some environment."""
    return {name: weld for name, weld in welds.items() if bool(weld.changed.any())}


def weld_data(pose: np.ndarray) -> np.ndarray:
    """The first ten numbers of a weld's ``eq_data`` for relative poses ``(k, 7)``.

    Anchor in the second body (its origin), the same point in the first, relative quaternion.
    """
    return np.concatenate((np.zeros((len(pose), 3)), pose), -1)


def varied_model(
    model: mujoco.MjModel, friction: np.ndarray, mass: np.ndarray
) -> dict[str, np.ndarray]:
    """Fields of a model by name, ``(k, ...)`` each, with other friction and masses.

    Args:
        model: as compiled.
        friction: factor of the friction of all geoms ``(k,)``.
        mass: factor of mass and inertia of the bodies that move freely ``(k,)``.
    """
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    factor = np.ones((len(mass), model.nbody))
    factor[:, free] = mass[:, None]
    return {
        "geom_friction": friction[:, None, None] * model.geom_friction,
        "body_mass": factor * model.body_mass,
        "body_inertia": factor[..., None] * model.body_inertia,
    }
