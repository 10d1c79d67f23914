"""Geoms as closed surfaces of triangles."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

_TOLERANCE = 1e-4
"""How far a polygon may cut into the circle it stands for, m: a twentieth of a 64 px pixel."""

_FEWEST, _MOST = 8, 48
"""Corners of such a polygon."""

_SMOOTH = 0.8
"""A mesh's authored normal counts where its cosine to the face's is larger (as in MuJoCo)."""


class Surface(NamedTuple):
    """Triangles in a geom's frame, m.

    ``vertices`` ``(v, 3)``; ``faces`` ``(t, 3)``, counter-clockwise seen from outside;
    ``normals`` ``(t, 3, 3)``: unit vectors to the outside at each face's corners.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray

    @property
    def planes(self) -> np.ndarray:
        """Each face's plane ``(t, 4)``: unit vector to the outside and distance from the origin."""
        a, b, c = self.vertices[self.faces].swapaxes(0, 1)
        out = np.cross(b - a, c - a)
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        return np.column_stack((out, (out * a).sum(1)))


def surface_of(model: mujoco.MjModel, geom: int) -> Surface:
    """The surface of a geom.

    Raises:
        ValueError: a type that can't be drawn, or a mesh that is inside out.
    """
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind not in _SHAPES:
        valid = ", ".join(shape.name for shape in (mujoco.mjtGeom.mjGEOM_PLANE, *_SHAPES))
        raise ValueError(f"geom {geom}: can't draw {kind.name}; choose from {valid}")
    surface = _SHAPES[kind](model, geom, size)
    first, second, third = surface.vertices[surface.faces].swapaxes(0, 1)
    if np.sum(first * np.cross(second, third)) <= 0:
        raise ValueError(f"geom {geom}: its faces are clockwise seen from outside; turn them")
    return surface


def _with_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which faces ``(t,)`` are more than a line."""
    a, b, c = vertices[faces].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return area > 1e-9 * area.max()


def _box(model: mujoco.MjModel, geom: int, size: np.ndarray) -> Surface:
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(-1, 3)
    quads = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    faces = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    sides = corners[quads].mean(1)
    return Surface(corners * size, faces, np.repeat(sides, 6, 0).reshape(-1, 3, 3))


def _cylinder(model: mujoco.MjModel, geom: int, size: np.ndarray) -> Surface:
    radius, half = size[:2]
    profile = [(0.0, -half), (radius, -half), (radius, half), (0.0, half)]
    down, out, up = (0.0, -1.0), (1.0, 0.0), (0.0, 1.0)
    return _revolve(np.array(profile), np.array([(down, down), (out, out), (up, up)]))


def _capsule(model: mujoco.MjModel, geom: int, size: np.ndarray) -> Surface:
    radius, half = size[:2]
    count = -(-_corners(radius) // 4)
    arc = np.linspace(0.0, np.pi / 2, count + 1)
    angles = np.concatenate((arc - np.pi / 2, arc))
    out = np.stack((np.cos(angles), np.sin(angles)), -1)
    centre = np.repeat([[0.0, -half], [0.0, half]], count + 1, 0)
    return _revolve(centre + radius * out, np.stack((out[:-1], out[1:]), 1))


def _mesh(model: mujoco.MjModel, geom: int, size: np.ndarray) -> Surface:
    mesh = int(model.geom_dataid[geom])

    def own(array: np.ndarray, start: np.ndarray, count: np.ndarray) -> np.ndarray:
        return array[start[mesh] : start[mesh] + count[mesh]]

    vertices = own(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum).astype(np.float64)
    faces = own(model.mesh_face, model.mesh_faceadr, model.mesh_facenum)
    authored = own(model.mesh_normal, model.mesh_normaladr, model.mesh_normalnum)
    indices = own(model.mesh_facenormal, model.mesh_faceadr, model.mesh_facenum)
    seen = _with_area(vertices, faces)
    faces, corners = faces[seen], authored[indices[seen]]
    flat = Surface(vertices, faces, corners).planes[:, None, :3]
    is_smooth = (corners * flat).sum(-1, keepdims=True) >= _SMOOTH
    return Surface(vertices, faces, np.where(is_smooth, corners, flat))


def _revolve(profile: np.ndarray, normals: np.ndarray) -> Surface:
    """A surface of revolution about z.

    Args:
        profile: radii and heights ``(k, 2)`` from the lower pole to the upper one, m.
        normals: outward and upward parts at the lower and upper edge of each band between
            them ``(k - 1, 2, 2)``.
    """
    sides, bands = _corners(profile[:, 0].max()), len(profile) - 1
    angles = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)

    def turned(pairs: np.ndarray) -> np.ndarray:
        across, up = pairs[..., None, 0], pairs[..., None, 1]
        turns = (across * np.cos(angles), across * np.sin(angles), up + 0.0 * angles)
        return np.stack(turns, -1)

    # Half outside the circle, half inside it.
    stretch = 2.0 / (1.0 + np.cos(np.pi / sides))
    vertices = turned(profile * [stretch, 1.0]).reshape(-1, 3)
    band, left = (grid.ravel() for grid in np.indices((bands, sides)))
    right = (left + 1) % sides
    cell = (np.array((0, 0, 1, 1)), np.stack((left, right, right, left), -1))
    quads = (band[:, None] + cell[0]) * sides + cell[1]
    corners = turned(normals)[band[:, None], cell[0], cell[1]]
    halves = [[0, 1, 2], [0, 2, 3]]
    faces, shaded = quads[:, halves].reshape(-1, 3), corners[:, halves].reshape(-1, 3, 3)
    # At a pole one half of each cell, on a band without width all of it, is a line.
    seen = _with_area(vertices, faces)
    return Surface(vertices, faces[seen], shaded[seen])


def _corners(radius: float) -> int:
    """Corners of a polygon that stays within ``_TOLERANCE`` of its circle."""
    half = np.arccos(max(0.0, 1.0 - _TOLERANCE / radius))
    return int(np.clip(np.ceil(np.pi / half), _FEWEST, _MOST))


_SHAPES = {
    mujoco.mjtGeom.mjGEOM_CAPSULE: _capsule,
    mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: _box,
    mujoco.mjtGeom.mjGEOM_MESH: _mesh,
}
