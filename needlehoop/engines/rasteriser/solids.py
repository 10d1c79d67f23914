"""Geoms as closed surfaces of triangles, packed for the kernel."""

# Warp's structs are no classes to pyright.
# pyright: reportGeneralTypeIssues=false
from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp

_TOLERANCE = 1e-4
"""How far a polygon may cut into the circle it stands for, m: a twentieth of a 64 px pixel."""

_FEWEST, _MOST = 8, 48
"""Corners of such a polygon."""

_SMOOTH = 0.8
"""A mesh's authored normal counts where its cosine to the face's is larger (as in MuJoCo)."""


@wp.struct
class Solid:
    """A drawn geom; its vertices and faces are a range (last excluded) of those in ``Solids``."""

    geom: int
    first_vertex: int
    last_vertex: int
    first_face: int
    last_face: int
    radius: float
    """Of the sphere about the geom's origin that holds it, m."""
    colour: wp.vec3
    """Red, green, blue; 1 is full."""
    ambient: wp.vec3
    """Light that reaches it without a lamp."""


@wp.struct
class Solids:
    """The same in every environment; vertices and planes in m in the geoms' frames."""

    solids: wp.array[Solid]
    table: wp.array[Solid]
    """None or one: the infinite plane, which has no faces."""
    vertices: wp.array[wp.vec3]
    faces: wp.array[wp.vec3i]
    planes: wp.array[wp.vec4]
    normals: wp.array[wp.vec3]
    """Three for each face."""
    owners: wp.array[int]
    """Index in ``solids`` of each face."""
    geoms: wp.array[int]
    """Geom of each face, then of the table, then -1."""
    lights: wp.array[int]
    """Those that shine."""
    lamps: wp.array[wp.vec3]
    """Their diffuse colours, and last the headlight's."""


def pack(model: mujoco.MjModel, device: wp.Device) -> Solids:
    """The drawn geoms and the lights of a scene, on a device of Warp's.

    Raises ``ValueError`` for what can't be drawn: a type of geom, a finite plane or more than one,
    a transparent geom, a light that isn't directional, a mesh that is inside out.
    """
    # Collision shapes are in group 3.
    drawn = [geom for geom in range(model.ngeom) if model.geom_group[geom] in (0, 1)]
    is_plane = {geom: model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE for geom in drawn}
    tables = [geom for geom in drawn if is_plane[geom]]
    if len(tables) > 1 or model.geom_size[tables, :2].any():
        raise ValueError(f"geoms {tables}: only one plane can be drawn, and an infinite one")
    bodies = [geom for geom in drawn if not is_plane[geom]]
    surfaces = [surface_of(model, geom) for geom in bodies]
    corners = [surface.vertices for surface in surfaces]
    vertices = np.cumsum([0, *map(len, corners)])
    faces = np.cumsum([0, *(len(surface.faces) for surface in surfaces)])
    rows = [
        (geom, *vertices[i : i + 2], *faces[i : i + 2], np.linalg.norm(points, axis=1).max())
        for i, (geom, points) in enumerate(zip(bodies, corners, strict=True))
    ]
    lights = model.light_active.nonzero()[0]
    if (model.light_type[lights] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL).any():
        raise ValueError("lights: only directional ones can be drawn")
    headlight = model.vis.headlight
    is_lit = bool(headlight.active)
    everywhere = headlight.ambient * is_lit + model.light_ambient[lights].sum(0)
    packed = Solids()
    packed.solids = _solids(model, rows, everywhere, device)
    packed.table = _solids(model, [(geom, 0, 0, 0, 0, 0.0) for geom in tables], everywhere, device)
    shifted = [s.faces + start for s, start in zip(surfaces, vertices[:-1], strict=True)]
    packed.vertices = _array(corners, wp.vec3, device)
    packed.faces = _array(shifted, wp.vec3i, device)
    packed.planes = _array([s.planes for s in surfaces], wp.vec4, device)
    packed.normals = _array([s.normals.reshape(-1, 3) for s in surfaces], wp.vec3, device)
    owners = np.repeat(np.arange(len(bodies)), np.diff(faces))
    packed.owners = _array([owners], int, device)
    packed.geoms = _array([np.array(bodies, int)[owners], (tables or [-1]), [-1]], int, device)
    packed.lights = _array([lights], int, device)
    packed.lamps = _array(
        [model.light_diffuse[lights], [headlight.diffuse * is_lit]], wp.vec3, device
    )
    return packed


def _solids(
    model: mujoco.MjModel, rows: list[tuple], everywhere: np.ndarray, device: wp.Device
) -> wp.array:
    """Solids from their numbers, with the colours of their geoms and the light everywhere."""
    solids = []
    for row in rows:
        geom = row[0]
        rgba, material, emission = model.geom_rgba[geom], int(model.geom_matid[geom]), 0.0
        if material >= 0:
            emission = model.mat_emission[material]
            # MuJoCo's geom colour gives way to the material's.
            if np.array_equal(rgba, np.array((0.5, 0.5, 0.5, 1.0), np.float32)):
                rgba = model.mat_rgba[material]
        if rgba[3] < 1:
            raise ValueError(f"geom {geom}: transparent geoms can't be drawn")
        solids.append((*row, rgba[:3], everywhere + emission))
    dtype: Any = Solid.numpy_dtype()
    return wp.array(np.array(solids, dtype), dtype=Solid, device=device)


def _array(parts: list, dtype: type, device: wp.Device) -> wp.array:
    """Parts one after the other; none are an empty array."""
    if not parts:
        return wp.zeros(0, dtype=dtype, device=device)
    return wp.array(np.concatenate(parts), dtype=dtype, device=device)


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
    """The surface of a geom; errors as in ``pack``."""
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

    def rows(array: np.ndarray, start: np.ndarray, count: np.ndarray) -> np.ndarray:
        return array[start[mesh] : start[mesh] + count[mesh]]

    vertices = rows(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum).astype(np.float64)
    faces = rows(model.mesh_face, model.mesh_faceadr, model.mesh_facenum)
    authored = rows(model.mesh_normal, model.mesh_normaladr, model.mesh_normalnum)
    indices = rows(model.mesh_facenormal, model.mesh_faceadr, model.mesh_facenum)
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
