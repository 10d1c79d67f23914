"""The kernels that draw many images at once: first solids, then faces, then pixels.

A face writes a pixel by one atomic maximum of 64 bits: those of 1/z above, those of the face's
complement below. So the nearest face wins, and of two as near the first, in any order of threads.
"""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportAssignmentType=false
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
from needlehoop.engines.rasteriser.kernel import (
    face_bounds,
    face_row,
    is_in_sight,
    outline_of,
    project_vertices,
)
from needlehoop.engines.rasteriser.shading import (
    light_lamps,
    seen_colour,
    table_colour,
    table_slope,
)
from needlehoop.engines.rasteriser.solids import Solids

_FLAGS = "-march=native -ffast-math -Wno-nan-infinity-disabled"  # as the other kernel's
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": _FLAGS})

STRIPS = wp.constant(4)
"""Threads that share the rows of a face."""

_LOW = wp.constant(wp.uint64(0xFFFFFFFF))


@wp.struct
class Images:
    """Images while they are drawn, a row each: by environment, then by lens."""

    corners: wp.array2d[wp.vec3]
    points: wp.array2d[wp.vec2]
    turns: wp.array2d[wp.mat33]
    lamps: wp.array2d[wp.vec3]
    """These as in ``ScratchBuffers``."""
    slopes: wp.array2d[wp.vec3]
    """Of each face, see ``slope_of``; zero if it is turned away."""
    seen: wp.array2d[int]
    """Whether each solid is in sight."""
    keys: wp.array2d[wp.uint64]
    """Of each pixel."""


@wp.func
def _scratch(images: Images, image: int) -> ScratchBuffers:
    """An image's own buffers."""
    scratch = ScratchBuffers()
    scratch.corners = images.corners[image]
    scratch.points = images.points[image]
    scratch.turns = images.turns[image]
    scratch.lamps = images.lamps[image]
    return scratch


@wp.func
def _eye(lenses: wp.array[Lens], poses: Poses, image: int, first: int, size: wp.vec2i) -> Eye:
    views = lenses.shape[0]
    return eye_of(poses, lenses[image % views], first + image // views, size)


@wp.kernel
def project(
    solids: Solids, lenses: wp.array[Lens], poses: Poses, images: Images, size: wp.vec2i, first: int
):
    """Each solid's sight, corners and slopes of the faces that are turned to the camera.

    ``first``: environment of the first image.
    """
    image, index = wp.tid()
    env = first + image // lenses.shape[0]
    eye = _eye(lenses, poses, image, first, size)
    scratch = _scratch(images, image)
    if index == 0:
        light_lamps(solids, poses, env, eye, scratch)
    solid = solids.solids[index]
    away = poses.geom_xpos[env, solid.geom] - eye.position
    at = eye.turn * away
    images.seen[image, index] = 0
    if not is_in_sight(eye, at, solid.radius):
        return
    images.seen[image, index] = 1
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
        slope = wp.vec3(0.0, 0.0, 0.0)
        if behind < 0.0:
            slope = slope_of(turn * out, behind, eye)
        images.slopes[image, face] = slope


@wp.kernel
def cover(
    solids: Solids, lenses: wp.array[Lens], poses: Poses, images: Images, size: wp.vec2i, first: int
):
    """Each face's pixels, a thread for every ``STRIPS``-th row."""
    image, face, strip = wp.tid()
    if images.seen[image, solids.owners[face]] == 0:
        return
    slope = images.slopes[image, face]
    if slope[0] == 0.0 and slope[1] == 0.0 and slope[2] == 0.0:
        return
    scratch = _scratch(images, image)
    corners = solids.faces[face]
    eye = _eye(lenses, poses, image, first, size)
    bounds = face_bounds(corners, scratch, eye)
    columns, outline = wp.vec2(bounds[0], bounds[1]), outline_of(corners, scratch)
    low = _LOW - wp.uint64(face)
    row = int(bounds[2]) + strip
    while row <= int(bounds[3]):
        span = face_row(outline, columns, float(row) + 0.5)
        if span[0] <= span[1]:
            start = slope[0] * 0.5 + slope[1] * (float(row) + 0.5) + slope[2]
            for column in range(int(wp.ceil(span[0])), int(wp.floor(span[1])) + 1):
                nearness = start + slope[0] * float(column)
                if nearness > 0.0:
                    high = wp.uint64(wp.cast(nearness, wp.uint32)) << wp.uint64(32)
                    pixel = row * eye.width + column - eye.left
                    wp.atomic_max(images.keys, image, pixel, high | low)
        row += STRIPS


@wp.kernel
def shade(
    solids: Solids,
    lenses: wp.array[Lens],
    poses: Poses,
    images: Images,
    size: wp.vec2i,
    first: int,
    frames: FrameBuffers,
):
    """Light what each pixel sees, with the table behind the solids; clear its key."""
    image, pixel = wp.tid()
    lens = lenses[image % lenses.shape[0]]
    env = first + image // lenses.shape[0]
    eye = _eye(lenses, poses, image, first, size)
    scratch = _scratch(images, image)
    row, column = pixel // size[0], eye.left + pixel % size[0]
    slope = table_slope(solids, poses, env, eye)
    start = slope[0] * 0.5 + slope[1] * (float(row) + 0.5) + slope[2]
    nearness = start + slope[0] * float(column)
    table = solids.faces.shape[0]
    face = wp.where(nearness > 0.0, table, table + 1)
    key = images.keys[image, pixel]
    images.keys[image, pixel] = wp.uint64(0)
    drawn = wp.cast(wp.uint32(key >> wp.uint64(32)), float)
    if drawn > wp.max(nearness, 0.0):
        nearness = drawn
        face = int(_LOW - (key & _LOW))
    at = env * size[0] * size[1] + pixel
    step = frames.count * size[0] * size[1]
    if lens.colour >= 0:
        flat = table_colour(solids, poses, env, eye, scratch)
        x, y = float(column) + 0.5, float(row) + 0.5
        frames.colour[lens.colour * step + at] = seen_colour(
            solids, poses, env, eye, scratch, face, nearness, flat, x, y
        )
    if lens.depth >= 0:
        frames.depth[lens.depth * step + at] = wp.where(nearness > 0.0, 1.0 / nearness, 0.0)
    if lens.geom >= 0:
        frames.geom[lens.geom * step + at] = solids.geoms[face]
