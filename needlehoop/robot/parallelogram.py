"""The parallelogram that holds the remote centre: a closed chain, or its inertia alone.

And the joint positions that keep it closed.
"""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop.robot import psm
from needlehoop.robot.shapes import Z_AXIS, Link, add_joint

# Linkage, m: WPI-AIM/dvrk_env psm.urdf.xacro and psm.sdf.
_BAR = 0.516
_CRANK, _CRANK_TILT = 0.150, 0.29073
_PIVOT_GAP = 0.096
MIMIC = {"pitch_bottom": -1.0, "pitch_end": 1.0, "pitch_top": -1.0, "pitch_front": 1.0}

# Masses of the arm's links, kg: same source.
MASS = {
    "yaw": 1.47,
    "back": 0.985,
    "bottom": 0.446,
    "top": 0.178,
    "front": 0.074,
    "end": 2.09,
    "insertion": 0.225,
    "tool": 0.194,
}


def linkage_ratios(model: mujoco.MjModel) -> dict[str, float]:
    """The linkage's passive joints and their positions per rad of pitch; none if serial."""
    names = {model.joint(i).name for i in range(model.njnt)}
    return {name: ratio for name, ratio in MIMIC.items() if name in names}


def pivots() -> dict[str, np.ndarray]:
    """Linkage pivots in home coordinates, m; the yaw axis is the RCM frame's y axis."""
    along = np.array([0.0, np.sin(_CRANK_TILT), np.cos(_CRANK_TILT)])
    forward = np.array([0.0, -_BAR, 0.0])
    back = -forward
    low, high = back + _CRANK * along, back + (_CRANK + _PIVOT_GAP) * along
    return {
        "back": back,
        "low": low,
        "high": high,
        "end_low": low + forward,
        "end_high": high + forward,
        "front_low": low + 0.72 * forward,
        "front_high": high + 0.72 * forward,
    }


def add_linkage(spec: mujoco.MjSpec, yaw: Link) -> Link:
    """The closed chain: crank, two bars, the carriage and a coupler; returns the carriage."""
    places = pivots()
    pitch = psm.JOINTS[psm.JOINT_NAMES.index("pitch")]
    home = yaw.home @ psm.dh_transform(pitch)
    # Every link of the linkage is turned like the pitch frame, so all hinges are its z.
    back = _add_hinged(yaw, "pitch_back", home[:3, :3], places["back"], pitch)
    back.rod(places["back"], places["high"], 0.016, "arm_dark", mass=MASS["back"])
    bottom = _add_hinged(back, "pitch_bottom", home[:3, :3], places["low"])
    bottom.rod(places["low"], places["end_low"], 0.011, "arm_light", mass=MASS["bottom"])
    top = _add_hinged(back, "pitch_top", home[:3, :3], places["high"])
    top.rod(places["high"], places["end_high"], 0.008, "arm_light", mass=MASS["top"])
    front = _add_hinged(bottom, "pitch_front", home[:3, :3], places["front_low"])
    front.rod(places["front_low"], places["front_high"], 0.008, "arm_dark", mass=MASS["front"])
    # The carriage hinges on the bottom bar, but its frame stays the DH frame at the RCM.
    end = bottom.body.add_body(
        name="pitch",
        pos=bottom.point(np.zeros(3)),
        gravcomp=1.0,
    )
    carriage = Link(end, home)
    end.add_joint(name="pitch_end", axis=Z_AXIS, pos=carriage.point(places["end_low"]))
    _close(spec, "top_to_end", top, carriage, places["end_high"])
    _close(spec, "top_to_front", top, front, places["front_high"])
    for name, ratio in MIMIC.items():
        equality = spec.add_equality(
            name=f"{name}_mimic",
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=name,
            name2="pitch",
            solref=[0.004, 1.0],
            solimp=[0.99, 0.999, 0.0001, 0.5, 2.0],
        )
        equality.data[:5] = [0.0, ratio, 0.0, 0.0, 0.0]
    return carriage


def _add_hinged(
    parent: Link,
    name: str,
    rotation: np.ndarray,
    pivot: np.ndarray,
    row: psm.Joint | None = None,
) -> Link:
    """A linkage body with its hinge at ``pivot`` (home coordinates).

    The hinge has the body's name, or is the joint of a DH ``row``.
    """
    home = np.eye(4)
    home[:3, :3], home[:3, 3] = rotation, pivot
    child = parent.body.add_body(
        name=name,
        pos=parent.point(pivot),
        quat=psm.quaternion(parent.home[:3, :3].T @ rotation),
        gravcomp=1.0,
    )
    if row is not None:
        add_joint(child, row)
    else:
        child.add_joint(name=name, axis=Z_AXIS)
    return Link(child, home)


def _close(spec: mujoco.MjSpec, name: str, one: Link, other: Link, pivot: np.ndarray) -> None:
    spec.add_equality(
        name=name,
        type=mujoco.mjtEq.mjEQ_CONNECT,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=one.body.name,
        name2=other.body.name,
        data=np.concatenate((one.point(pivot), np.zeros(9))),
        solref=[0.004, 1.0],
        solimp=[0.99, 0.999, 0.0001, 0.5, 2.0],
    )


def carry_linkage_inertia(yaw: Link, pitch: Link) -> None:
    """Armature that stands in for the linkage, from its masses and pivot distances."""
    high = _CRANK + _PIVOT_GAP
    mean = _CRANK + _PIVOT_GAP / 2
    pitching = (
        MASS["back"] * high**2 / 3
        + MASS["bottom"] * _CRANK**2
        + MASS["top"] * high**2
        + MASS["front"] * mean**2
    )
    # About the yaw axis the bars hang at the cosine of the crank's tilt.
    yawing = pitching * np.cos(_CRANK_TILT) ** 2
    yaw.body.joints[0].armature = yawing
    pitch.body.joints[0].armature = pitching


class Posture:
    """Writes postures of the arm into generalised positions.

    Args:
        model: a compiled model with the arm in it.
    """

    def __init__(self, model: mujoco.MjModel):
        def address(name: str) -> int:
            return int(model.joint(name).qposadr[0])

        self._joints = [address(name) for name in psm.JOINT_NAMES]
        self._jaws = [address("jaw_1"), address("jaw_2")]
        self._linkage = {address(name): ratio for name, ratio in linkage_ratios(model).items()}

    def write(self, qpos: np.ndarray, joints: np.ndarray, jaw: np.ndarray) -> None:
        """Put the arm, its linkage closed, into ``qpos`` ``(k, nq)``.

        ``joints`` ``(k, 6)`` in the order of ``psm.JOINTS``, rad and m; ``jaw`` ``(k,)``, rad.
        """
        qpos[:, self._joints] = joints
        for address, ratio in self._linkage.items():
            qpos[:, address] = ratio * joints[:, psm.JOINT_NAMES.index("pitch")]
        qpos[:, self._jaws[0]], qpos[:, self._jaws[1]] = jaw / 2, -jaw / 2
