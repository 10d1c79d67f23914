"""The kernel that draws: solids into the scratch buffers, and from there lit images."""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

from needlehoop.engines.rasteriser.buffers import (
    Eye,
    FrameBuffers,
    Lens,
    Poses,
    ScratchBuffers,
    eye_of,
    slope_of,
)
from needlehoop.engines.rasteriser.shading import (
    light_lamps,
    packed,
    seen_colour,
    table_colour,
    table_slope,
)
from needlehoop.engines.rasteriser.solids import Solid, Solids

# Sums in any order: a tenth faster. Warp's own headers name infinity and NaN; the compiler would
# then print a page of warnings.
_FLAGS = "-march=native -ffast-math -Wno-nan-infinity-disabled"
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": _FLAGS})

_NEAR = wp.constant(1e-6)
"""Nearer points, m, are not divided by their depth."""

_FLAT = wp.constant(1e-12)
"""Edges that rise less along a row are parallel to it."""


@wp.func
def is_in_sight(eye: Eye, at: wp.vec3, radius: float) -> bool:
    """Whether a sphere at ``at`` (camera frame) may be in the image."""
    wide = eye.tangent * float(eye.width) / float(eye.height)
    beside = wide * at[2] + radius * wp.sqrt(1.0 + wide * wide)
    above = eye.tangent * at[2] + radius * wp.sqrt(1.0 + eye.tangent * eye.tangent)
    return at[2] > -radius and wp.abs(at[0]) < beside and wp.abs(at[1]) < above


@wp.func
def project_vertices(
    solids: Solids, solid: Solid, eye: Eye, turn: wp.mat33, at: wp.vec3, scratch: ScratchBuffers
):
    """Project a solid's vertices into the scratch buffers."""
    right = eye.focal * turn[0] + eye.centre * turn[2]
    down = eye.focal * turn[1] + eye.centre * turn[2]
    ahead = turn[2]
    x = eye.focal * at[0] + eye.centre * at[2]
    y = eye.focal * at[1] + eye.centre * at[2]
    for v in range(solid.first_vertex, solid.last_vertex):
        vertex = solids.vertices[v]
        corner = wp.vec3(
            wp.dot(right, vertex) + x, wp.dot(down, vertex) + y, wp.dot(ahead, vertex) + at[2]
        )
        scratch.corners[v] = corner
        nearness = 1.0 / wp.max(corner[2], _NEAR)
        scratch.points[v] = wp.vec2(corner[0] * nearness, corner[1] * nearness)


@wp.func
def _limit(edge: wp.vec3) -> wp.vec2:
    """Where an edge crosses a row: change per row, and pixel's index at y = 0."""
    rise = wp.where(wp.abs(edge[0]) > _FLAT, edge[0], _FLAT)
    return wp.vec2(-edge[1] / rise, -edge[2] / rise - 0.5)


@wp.func
def _cut(span: wp.vec2, edge: wp.vec3, limit: wp.vec2, y: float) -> wp.vec2:
    """The part of a row, first to last pixel's index, on an edge's inner side."""
    at = limit[0] * y + limit[1]
    is_left = edge[0] < -_FLAT
    return wp.vec2(
        wp.where(is_left, wp.max(span[0], at), span[0]),
        wp.where(is_left, span[1], wp.min(span[1], at)),
    )


@wp.func
def _bounds(a: float, b: float, c: float, limits: wp.vec2) -> wp.vec2:
    """First and last pixel, within limits, whose centre lies between the least and greatest."""
    least, greatest = wp.min(wp.min(a, b), c), wp.max(wp.max(a, b), c)
    return wp.vec2(
        wp.ceil(wp.max(least - 0.5, limits[0])), wp.floor(wp.min(greatest - 0.5, limits[1]))
    )


@wp.func
def face_bounds(corners: wp.vec3i, scratch: ScratchBuffers, eye: Eye) -> wp.vec4:
    """First and last column, first and last row that a face may cover; none: the last is less."""
    a, b, c = scratch.corners[corners[0]], scratch.corners[corners[1]], scratch.corners[corners[2]]
    columns = wp.vec2(float(eye.left), float(eye.left + eye.width - 1))
    rows = wp.vec2(0.0, float(eye.height - 1))
    if wp.min(wp.min(a[2], b[2]), c[2]) > _NEAR:
        p, q, r = scratch.points[corners[0]], scratch.points[corners[1]], scratch.points[corners[2]]
        columns, rows = _bounds(p[0], q[0], r[0], columns), _bounds(p[1], q[1], r[1], rows)
    return wp.vec4(columns[0], columns[1], rows[0], rows[1])


@wp.struct
class Outline:
    """A face's edges, negative inside it, and where each crosses a row, see ``_limit``."""

    ab: wp.vec3
    bc: wp.vec3
    ca: wp.vec3
    at_ab: wp.vec2
    at_bc: wp.vec2
    at_ca: wp.vec2


@wp.func
def outline_of(corners: wp.vec3i, scratch: ScratchBuffers) -> Outline:
    a, b, c = scratch.corners[corners[0]], scratch.corners[corners[1]], scratch.corners[corners[2]]
    outline = Outline()
    outline.ab = wp.cross(a, b)
    outline.bc = wp.cross(b, c)
    outline.ca = wp.cross(c, a)
    outline.at_ab = _limit(outline.ab)
    outline.at_bc = _limit(outline.bc)
    outline.at_ca = _limit(outline.ca)
    return outline


@wp.func
def face_row(outline: Outline, columns: wp.vec2, y: float) -> wp.vec2:
    """The part of a row that lies in a face, first to last pixel's index, not whole numbers."""
    span = _cut(columns, outline.ab, outline.at_ab, y)
    return _cut(_cut(span, outline.bc, outline.at_bc, y), outline.ca, outline.at_ca, y)


@wp.func
def _draw_face(face: int, corners: wp.vec3i, slope: wp.vec3, eye: Eye, scratch: ScratchBuffers):
    """Fill the pixels whose centres lie in a face and that see nothing nearer; see ``slope_of``."""
    bounds = face_bounds(corners, scratch, eye)
    columns = wp.vec2(bounds[0], bounds[1])
    if bounds[0] > bounds[1] or bounds[2] > bounds[3]:
        return
    outline = outline_of(corners, scratch)
    for row in range(int(bounds[2]), int(bounds[3]) + 1):
        y = float(row) + 0.5
        span = face_row(outline, columns, y)
        if span[0] > span[1]:
            continue
        first, last = int(wp.ceil(span[0])), int(wp.floor(span[1]))
        start = slope[0] * 0.5 + slope[1] * y + slope[2]
        for column in range(first, last + 1):
            nearness = start + slope[0] * float(column)
            pixel = row * eye.width + column - eye.left
            if nearness > scratch.nearness[pixel]:
                scratch.nearness[pixel] = nearness
                scratch.face[pixel] = face


@wp.func
def _draw_solid(
    solids: Solids, index: int, poses: Poses, env: int, eye: Eye, scratch: ScratchBuffers
):
    solid = solids.solids[index]
    away = poses.geom_xpos[env, solid.geom] - eye.position
    at = eye.turn * away
    if not is_in_sight(eye, at, solid.radius):
        return
    axes = poses.geom_xmat[env, solid.geom]
    turn = eye.turn * axes
    scratch.turns[index] = turn
    project_vertices(solids, solid, eye, turn, at, scratch)
    # The camera in the solid's frame.
    here = -(wp.transpose(axes) * away)
    for face in range(solid.first_face, solid.last_face):
        plane = solids.planes[face]
        out = wp.vec3(plane[0], plane[1], plane[2])
        behind = plane[3] - wp.dot(out, here)
        # Of a closed surface only the faces turned to the camera are seen.
        if behind < 0.0:
            slope = slope_of(turn * out, behind, eye)
            _draw_face(face, solids.faces[face], slope, eye, scratch)


@wp.func
def _expose(
    solids: Solids,
    poses: Poses,
    lens: Lens,
    env: int,
    eye: Eye,
    scratch: ScratchBuffers,
    frames: FrameBuffers,
):
    """Light what each pixel sees, with the table behind the solids; clear the scratch buffers.

    As mujoco_warp's ray tracer shades: ambient and diffuse light, no shadows, no highlights,
    but for what the ``OPTICS`` say.
    """
    light_lamps(solids, poses, env, eye, scratch)
    slope = table_slope(solids, poses, env, eye)
    flat = table_colour(solids, poses, env, eye, scratch)
    # Most pixels see the table without a pattern.
    plain, nothing = packed(flat), wp.uint32(255 << 24)
    is_plain = poses.table_grain[env, 0][0] <= 0.0
    table = solids.faces.shape[0]
    pixels = eye.width * eye.height
    colour, depth, geom = (
        (lens.colour * frames.count + env) * pixels,
        (lens.depth * frames.count + env) * pixels,
        (lens.geom * frames.count + env) * pixels,
    )
    for row in range(eye.height):
        start = slope[0] * 0.5 + slope[1] * (float(row) + 0.5) + slope[2]
        for column in range(eye.left, eye.left + eye.width):
            pixel = row * eye.width + column - eye.left
            nearness = start + slope[0] * float(column)
            face = wp.where(nearness > 0.0, table, table + 1)
            seen = wp.where(nearness > 0.0, plain, nothing)
            x, y = float(column) + 0.5, float(row) + 0.5
            if scratch.nearness[pixel] > wp.max(nearness, 0.0):
                nearness = scratch.nearness[pixel]
                face = scratch.face[pixel]
            if lens.colour >= 0 and (face < table or not is_plain):
                seen = seen_colour(solids, poses, env, eye, scratch, face, nearness, flat, x, y)
            scratch.nearness[pixel] = 0.0
            if lens.colour >= 0:
                frames.colour[colour + pixel] = seen
            if lens.depth >= 0:
                frames.depth[depth + pixel] = wp.where(nearness > 0.0, 1.0 / nearness, 0.0)
            if lens.geom >= 0:
                frames.geom[geom + pixel] = solids.geoms[face]


@wp.kernel
def draw(
    solids: Solids,
    lenses: wp.array[Lens],
    poses: Poses,
    scratch: ScratchBuffers,
    frames: FrameBuffers,
    size: wp.vec2i,
    first: int,
    last: int,
):
    """Draw environments ``first`` to ``last`` (excluded) through every lens.

    ``size``: width and height of the images, pixels.
    """
    for env in range(first, last):
        for view in range(lenses.shape[0]):
            lens = lenses[view]
            eye = eye_of(poses, lens, env, size)
            for index in range(solids.solids.shape[0]):
                _draw_solid(solids, index, poses, env, eye, scratch)
            _expose(solids, poses, lens, env, eye, scratch, frames)
