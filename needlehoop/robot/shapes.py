"""What the arm and the task's things are drawn with: links with their shapes, and meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from needlehoop.robot import psm

# Dry (N m, N) and viscous (N m s/rad, N s/m) friction: WPI dynamics identification.
FRICTION = {
    "yaw": (0.050, 0.0905),
    "pitch": (0.0668, 0.218),
    "insertion": (0.4476, 1.2036),
}


Z_AXIS = np.array([0.0, 0.0, 1.0])
"""Every joint turns about, or slides along, its own frame's z."""

# Reflected rotor inertia of the instrument's axes, kg m^2. The published inertias of these
# links are zero; without a floor of this order a stiff servo cannot be integrated at 2 ms.
TOOL_ARMATURE = 3e-4


@dataclass(frozen=True)
class Link:
    """A body with its frame's home pose in the RCM frame."""

    body: mujoco.MjsBody
    home: np.ndarray

    def point(self, xyz: np.ndarray | list[float]) -> np.ndarray:
        """Home coordinates to the body's frame."""
        return self.home[:3, :3].T @ (np.asarray(xyz, float) - self.home[:3, 3])

    def home_of(self, xyz: list[float]) -> np.ndarray:
        """The body's frame to home coordinates."""
        return self.home[:3, :3] @ np.asarray(xyz) + self.home[:3, 3]

    def rod(self, start, end, radius, material, kind="capsule", **geom) -> None:
        """A capsule or cylinder between two points in home coordinates, m."""
        shape = mujoco.mjtGeom.mjGEOM_CAPSULE
        if kind == "cylinder":
            shape = mujoco.mjtGeom.mjGEOM_CYLINDER
        ends = np.concatenate((self.point(start), self.point(end)))
        self._add(type=shape, fromto=ends, size=[radius, 0, 0], material=material, **geom)

    def box(self, centre, size, material, **geom) -> None:
        """A box with its centre and edges in home coordinates, m."""
        self._add(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=self.point(centre),
            quat=psm.quaternion(self.home[:3, :3].T),
            size=np.asarray(size) / 2,
            material=material,
            **geom,
        )

    def _add(self, **geom) -> None:
        collides = geom.pop("collides", False)
        geom.setdefault("mass", 0.0)
        geom |= collision(True) if collides else collision(False)
        self.body.add_geom(**geom)


def collision(solid: bool) -> dict[str, int]:
    """Geom fields for a shape that is only felt (``solid``) or only seen.

    Group 3 is hidden from the cameras; group 1 is drawn.
    """
    if solid:
        return {"contype": 1, "conaffinity": 1, "group": 3}
    return {"contype": 0, "conaffinity": 0, "group": 1}


def add_joint(body: mujoco.MjsBody, joint: psm.Joint) -> None:
    """Give a body the joint of a DH row, with its limits, friction and rotor inertia."""
    dry, viscous = FRICTION.get(joint.name, (0.0, 0.0))
    kind = mujoco.mjtJoint.mjJNT_SLIDE if joint.prismatic else mujoco.mjtJoint.mjJNT_HINGE
    body.add_joint(
        name=joint.name,
        type=kind,
        axis=Z_AXIS,
        range=[joint.lower, joint.upper],
        limited=True,
        frictionloss=dry,
        damping=[viscous, 0.0, 0.0],
        armature=0.0 if joint.name in FRICTION else TOOL_ARMATURE,
    )


class Mesh(NamedTuple):
    """Triangles: ``vertices`` ``(n, 3)`` in m, ``faces`` ``(m, 3)`` counter-clockwise."""

    vertices: np.ndarray
    faces: np.ndarray


def tube(curve: np.ndarray, radius: float, taper: float = 0.0, sides: int = 6) -> Mesh:
    """A round tube along a planar curve, with closed ends.

    Args:
        curve: centre line ``(n, 3)`` in the xy plane, m.
        radius: radius of the cross-section, m.
        taper: fraction of the curve at its end that narrows to a point.
        sides: corners of the cross-section.
    """
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.cross(tangent, [0.0, 0.0, 1.0])
    at = np.linspace(0.0, 1.0, len(curve))
    width = radius * np.clip((1.0 - at) / taper, 0.08, 1.0) if taper else np.full(len(at), radius)
    angles = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    rings = [
        point + w * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles), [0.0, 0.0, 1.0]))
        for point, side, w in zip(curve, across, width, strict=True)
    ]
    vertices = np.concatenate([*rings, curve[:1], curve[-1:]])
    faces = _quads(len(curve), sides, wrap=False)
    first, last, start = len(vertices) - 2, len(vertices) - 1, (len(curve) - 1) * sides
    for i in range(sides):
        j = (i + 1) % sides
        faces += [(first, j, i), (last, start + i, start + j)]
    # The sections turn against the curve, so that the cells between them face inwards.
    return Mesh(vertices, np.array(faces, dtype=np.int32)[:, ::-1])


def torus(radius: float, thickness: float, segments: int = 24, sides: int = 6) -> Mesh:
    """A ring about the y axis.

    Args:
        radius: centre to the middle of the ring's material, m.
        thickness: radius of the cross-section, m.
        segments: corners of the ring.
        sides: corners of the cross-section.
    """
    u = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)[:, None]
    v = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)[None, :]
    out = radius + thickness * np.cos(v)
    vertices = np.stack(
        (out * np.cos(u), thickness * np.sin(v) + 0.0 * u, out * np.sin(u)), -1
    ).reshape(-1, 3)
    faces = _quads(segments, sides, wrap=True)
    return Mesh(vertices, np.array(faces, dtype=np.int32))


def _quads(rings: int, sides: int, wrap: bool) -> list[tuple[int, int, int]]:
    """Two triangles for each cell between neighbouring rings of vertices."""
    faces = []
    for r in range(rings if wrap else rings - 1):
        here, there = r * sides, (r + 1) % rings * sides
        for i in range(sides):
            j = (i + 1) % sides
            faces += [(here + i, here + j, there + j), (here + i, there + j, there + i)]
    return faces
