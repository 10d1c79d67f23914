"""What there is to draw, packed for the kernel."""

# Warp's structs are no classes to pyright.
# pyright: reportGeneralTypeIssues=false
from typing import Any

import mujoco
import numpy as np
import warp as wp

from needlehoop.engines.rasteriser.surfaces import surface_of


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


def pack(model: mujoco.MjModel) -> Solids:
    """The drawn geoms and the lights of a scene.

    Raises:
        ValueError: something that can't be drawn: a type of geom, a finite plane or more than
            one, a transparent geom, a light that isn't directional.
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
        (geom, *vertices[i : i + 2], *faces[i : i + 2], np.linalg.norm(own, axis=1).max())
        for i, (geom, own) in enumerate(zip(bodies, corners, strict=True))
    ]
    lights = model.light_active.nonzero()[0]
    if (model.light_type[lights] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL).any():
        raise ValueError("lights: only directional ones can be drawn")
    headlight = model.vis.headlight
    is_lit = bool(headlight.active)
    everywhere = headlight.ambient * is_lit + model.light_ambient[lights].sum(0)
    packed = Solids()
    packed.solids = _solids(model, rows, everywhere)
    packed.table = _solids(model, [(geom, 0, 0, 0, 0, 0.0) for geom in tables], everywhere)
    shifted = [s.faces + start for s, start in zip(surfaces, vertices[:-1], strict=True)]
    packed.vertices = _array(corners, wp.vec3)
    packed.faces = _array(shifted, wp.vec3i)
    packed.planes = _array([s.planes for s in surfaces], wp.vec4)
    packed.normals = _array([s.normals.reshape(-1, 3) for s in surfaces], wp.vec3)
    owners = np.repeat(np.arange(len(bodies)), np.diff(faces))
    packed.owners = _array([owners], int)
    packed.geoms = _array([np.array(bodies, int)[owners], (tables or [-1]), [-1]], int)
    packed.lights = _array([lights], int)
    packed.lamps = _array([model.light_diffuse[lights], [headlight.diffuse * is_lit]], wp.vec3)
    return packed


def _solids(model: mujoco.MjModel, rows: list[tuple], everywhere: np.ndarray) -> wp.array:
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
    return wp.array(np.array(solids, dtype), dtype=Solid, device="cpu")


def _array(parts: list, dtype: type) -> wp.array:
    """Parts one after the other; none are an empty array."""
    if not parts:
        return wp.zeros(0, dtype=dtype, device="cpu")
    return wp.array(np.concatenate(parts), dtype=dtype, device="cpu")
