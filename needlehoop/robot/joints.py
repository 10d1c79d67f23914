"""The PSM's joints, as published; sources in ``psm``. No simulator, no torch."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

VARIANTS = ("serial", "parallelogram")
"""How the arm pitches: one link about the remote centre, or the closed linkage; see ``arm``."""


@dataclass(frozen=True)
class Joint:
    """One row of the modified DH table, with the joint's limits.

    Lengths in m, angles in rad. ``effort`` is the actuator's limit in N m, or in N for
    the prismatic insertion.
    """

    name: str
    prismatic: bool
    alpha: float
    a: float
    d: float
    theta: float
    lower: float
    upper: float
    effort: float


JOINTS = (
    Joint("yaw", False, pi / 2, 0.0, 0.0, pi / 2, -1.588, 1.588, 3.316),
    Joint("pitch", False, -pi / 2, 0.0, 0.0, -pi / 2, -0.925, 0.925, 3.316),
    Joint("insertion", True, pi / 2, 0.0, -0.4318, 0.0, 0.0, 0.24, 9.878),
    Joint("roll", False, 0.0, 0.0, 0.4162, 0.0, -4.538, 4.538, 0.33),
    Joint("wrist_pitch", False, -pi / 2, 0.0, 0.0, -pi / 2, -1.396, 1.396, 0.25),
    Joint("wrist_yaw", False, -pi / 2, 0.0091, 0.0, -pi / 2, -1.396, 1.396, 0.20),
)
JOINT_NAMES = tuple(joint.name for joint in JOINTS)
