"""Draws solids into the scratch buffers, triangle by triangle."""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

from needlehoop.engines.rasteriser.buffers import Eye, Poses, ScratchBuffers, slope_of
from needlehoop.engines.rasteriser.solids import Solid, Solids

_NEAR = wp.constant(1e-6)
"""Nearer points, m, are not divided by their depth."""

_FLAT = wp.constant(1e-12)
"""Edges that rise less along a row are parallel to it."""


@wp.func
def _is_in_sight(eye: Eye, at: wp.vec3, radius: float) -> bool:
    """Whether a sphere at ``at`` (camera frame) may be in the image."""
    reach = eye.tangent * at[2] + radius * wp.sqrt(1.0 + eye.tangent * eye.tangent)
    return at[2] > -radius and wp.abs(at[0]) < reach and wp.abs(at[1]) < reach


@wp.func
def _project(
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
def _bounds(a: float, b: float, c: float, size: int) -> wp.vec2:
    """First and last pixel whose centre lies between the least and the greatest."""
    least, greatest = wp.min(wp.min(a, b), c), wp.max(wp.max(a, b), c)
    return wp.vec2(
        wp.ceil(wp.max(least - 0.5, 0.0)), wp.floor(wp.min(greatest - 0.5, float(size - 1)))
    )


@wp.func
def _draw_face(face: int, corners: wp.vec3i, slope: wp.vec3, eye: Eye, scratch: ScratchBuffers):
    """Fill the pixels whose centres lie in a face and that see nothing nearer.

    Args:
        face: its index.
        corners: its vertices.
        slope: change of 1/z per pixel to the right and down, and its value at the upper left
            corner of the image.
        eye: who looks.
        scratch: where to.
    """
    a, b, c = scratch.corners[corners[0]], scratch.corners[corners[1]], scratch.corners[corners[2]]
    columns, rows = wp.vec2(0.0, float(eye.size - 1)), wp.vec2(0.0, float(eye.size - 1))
    if wp.min(wp.min(a[2], b[2]), c[2]) > _NEAR:
        p, q, r = scratch.points[corners[0]], scratch.points[corners[1]], scratch.points[corners[2]]
        columns, rows = _bounds(p[0], q[0], r[0], eye.size), _bounds(p[1], q[1], r[1], eye.size)
    if columns[0] > columns[1] or rows[0] > rows[1]:
        return
    # Inside a face each of these is negative.
    ab, bc, ca = wp.cross(a, b), wp.cross(b, c), wp.cross(c, a)
    at_ab, at_bc, at_ca = _limit(ab), _limit(bc), _limit(ca)
    for row in range(int(rows[0]), int(rows[1]) + 1):
        y = float(row) + 0.5
        span = _cut(columns, ab, at_ab, y)
        span = _cut(_cut(span, bc, at_bc, y), ca, at_ca, y)
        if span[0] > span[1]:
            continue
        first, last = int(wp.ceil(span[0])), int(wp.floor(span[1]))
        start = slope[0] * 0.5 + slope[1] * y + slope[2]
        for column in range(first, last + 1):
            nearness = start + slope[0] * float(column)
            pixel = row * eye.size + column
            if nearness > scratch.nearness[pixel]:
                scratch.nearness[pixel] = nearness
                scratch.face[pixel] = face


@wp.func
def draw_solid(
    solids: Solids, index: int, poses: Poses, env: int, eye: Eye, scratch: ScratchBuffers
):
    solid = solids.solids[index]
    away = poses.geom_xpos[env, solid.geom] - eye.position
    at = eye.turn * away
    if not _is_in_sight(eye, at, solid.radius):
        return
    axes = poses.geom_xmat[env, solid.geom]
    turn = eye.turn * axes
    scratch.turns[index] = turn
    _project(solids, solid, eye, turn, at, scratch)
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
