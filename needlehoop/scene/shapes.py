"""Shapes that tasks draw and feel things with: upright rods, and meshes that are made here."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np


def collision(solid: bool) -> dict[str, int]:
    """Geom fields for a shape that is only felt (``solid``) or only seen.

    Group 3 is hidden from the cameras; group 1 is drawn.
    """
    if solid:
        return {"contype": 1, "conaffinity": 1, "group": 3}
    return {"contype": 0, "conaffinity": 0, "group": 1}


def add_upright(
    body: mujoco.MjsBody,
    name: str,
    heights: tuple[float, float],
    radius: float,
    material: str,
    kind: mujoco.mjtGeom = mujoco.mjtGeom.mjGEOM_CYLINDER,
    solid: bool = True,
) -> None:
    """A cylinder or capsule along z that is seen; and ``<name>_solid``, felt, if it is solid.

    ``heights``: of its lower and upper end in the body's frame, m.
    """
    low, high = heights
    shape = {"type": kind, "fromto": [0, 0, low, 0, 0, high], "size": [radius, 0, 0]}
    body.add_geom(name=name, material=material, **shape, **collision(False))
    if solid:
        body.add_geom(name=f"{name}_solid", solref=[0.004, 1.0], **shape, **collision(True))


_SIDES = 6
"""Corners of a tube's cross-section."""


class Mesh(NamedTuple):
    """Triangles: ``vertices`` ``(n, 3)`` in m, ``faces`` ``(m, 3)`` counter-clockwise."""

    vertices: np.ndarray
    faces: np.ndarray


def add_mesh(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, mesh: Mesh, material: str
) -> None:
    """A mesh that is seen and touches nothing, the geom ``<name>_shape`` of a body."""
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    body.add_geom(
        name=f"{name}_shape",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        mass=0.0,
        **collision(False),
    )


def tube(curve: np.ndarray, radius: float, taper: float) -> Mesh:
    """A round tube along a planar curve, with closed ends.

    Args:
        curve: centre line ``(n, 3)`` in the xy plane, m.
        radius: of the cross-section, m.
        taper: fraction of the curve at its end that narrows to a point.
    """
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.cross(tangent, [0.0, 0.0, 1.0])
    at = np.linspace(0.0, 1.0, len(curve))
    width = radius * np.clip((1.0 - at) / taper, 0.08, 1.0)
    angles = np.linspace(0.0, 2 * np.pi, _SIDES, endpoint=False)
    rings = [
        point + w * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles), [0.0, 0.0, 1.0]))
        for point, side, w in zip(curve, across, width, strict=True)
    ]
    vertices = np.concatenate([*rings, curve[:1], curve[-1:]])
    faces = _quads(len(curve), wrap=False)
    first, last, start = len(vertices) - 2, len(vertices) - 1, (len(curve) - 1) * _SIDES
    for i in range(_SIDES):
        j = (i + 1) % _SIDES
        faces += [(first, j, i), (last, start + i, start + j)]
    # The sections turn against the curve, so that the cells between them face inwards.
    return Mesh(vertices, np.array(faces, dtype=np.int32)[:, ::-1])


def torus(radius: float, thickness: float) -> Mesh:
    """A ring about the y axis, out of 24 pieces.

    Args:
        radius: centre to the middle of the ring's material, m.
        thickness: radius of the cross-section, m.
    """
    u = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)[:, None]
    v = np.linspace(0.0, 2 * np.pi, _SIDES, endpoint=False)[None, :]
    out = radius + thickness * np.cos(v)
    vertices = np.stack(
        (out * np.cos(u), thickness * np.sin(v) + 0.0 * u, out * np.sin(u)), -1
    ).reshape(-1, 3)
    return Mesh(vertices, np.array(_quads(len(u), wrap=True), dtype=np.int32))


def _quads(rings: int, wrap: bool) -> list[tuple[int, int, int]]:
    """Two triangles for each cell between neighbouring rings of vertices."""
    faces = []
    for r in range(rings if wrap else rings - 1):
        here, there = r * _SIDES, (r + 1) % rings * _SIDES
        for i in range(_SIDES):
            j = (i + 1) % _SIDES
            faces += [(here + i, here + j, there + j), (here + i, there + j, there + i)]
    return faces
