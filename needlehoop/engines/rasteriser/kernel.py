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
from needlehoop.engines.rasteriser.filling import draw_solid
from needlehoop.engines.rasteriser.solids import Solid, Solids

# Sums in any order: a tenth faster. Warp's own headers name infinity and NaN; the compiler would
# then print a page of warnings.
_FLAGS = "-march=native -ffast-math -Wno-nan-infinity-disabled"
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": _FLAGS})


@wp.func
def _lit(solids: Solids, solid: Solid, normal: wp.vec3, scratch: ScratchBuffers) -> wp.uint32:
    """Colour of a surface with a normal in the camera frame."""
    light = solid.ambient
    for lamp in range(solids.lamps.shape[0]):
        light += wp.max(wp.dot(normal, scratch.lamps[lamp]), 0.0) * solids.lamps[lamp]
    red, green, blue = (
        int(255.0 * wp.clamp(solid.colour[0] * light[0], 0.0, 1.0)),
        int(255.0 * wp.clamp(solid.colour[1] * light[1], 0.0, 1.0)),
        int(255.0 * wp.clamp(solid.colour[2] * light[2], 0.0, 1.0)),
    )
    return wp.uint32((255 << 24) | (red << 16) | (green << 8) | blue)


@wp.func
def _normal(
    solids: Solids, face: int, x: float, y: float, eye: Eye, scratch: ScratchBuffers
) -> wp.vec3:
    """Unit normal of a face in the camera frame where a pixel sees it, turned to the camera."""
    corners = solids.faces[face]
    a, b, c = scratch.corners[corners[0]], scratch.corners[corners[1]], scratch.corners[corners[2]]
    pixel = wp.vec3(x, y, 1.0)
    # The signed areas of the parts that the pixel divides the face into, all of one sign.
    blend = (
        wp.dot(wp.cross(b, c), pixel) * solids.normals[3 * face]
        + wp.dot(wp.cross(c, a), pixel) * solids.normals[3 * face + 1]
        + wp.dot(wp.cross(a, b), pixel) * solids.normals[3 * face + 2]
    )
    normal = wp.normalize(scratch.turns[solids.owners[face]] * blend)
    ray = wp.vec3(x - eye.centre, y - eye.centre, eye.focal)
    return wp.where(wp.dot(normal, ray) > 0.0, -normal, normal)


@wp.func
def _light_lamps(solids: Solids, poses: Poses, env: int, eye: Eye, scratch: ScratchBuffers):
    lights = solids.lights.shape[0]
    for light in range(lights):
        scratch.lamps[light] = -(eye.turn * poses.light_xdir[env, solids.lights[light]])
    # The headlight shines along the optical axis.
    scratch.lamps[lights] = wp.vec3(0.0, 0.0, -1.0)


@wp.func
def _table(solids: Solids, poses: Poses, env: int, eye: Eye) -> wp.vec3:
    """Slope of the table, see ``slope_of``; zero where there is none to be seen."""
    if solids.table.shape[0] > 0:
        geom = solids.table[0].geom
        up = wp.transpose(poses.geom_xmat[env, geom])[2]
        below = wp.dot(up, poses.geom_xpos[env, geom] - eye.position)
        # From below a plane is not seen.
        if below < 0.0:
            return slope_of(eye.turn * up, below, eye)
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def expose(
    solids: Solids,
    poses: Poses,
    lens: Lens,
    env: int,
    eye: Eye,
    scratch: ScratchBuffers,
    frames: FrameBuffers,
):
    """Light what each pixel sees, with the table behind the solids; clear the scratch buffers.

    As mujoco_warp's ray tracer shades: ambient and diffuse light, no shadows, no highlights.
    """
    _light_lamps(solids, poses, env, eye, scratch)
    slope = _table(solids, poses, env, eye)
    nothing = wp.uint32(255 << 24)
    plain = nothing
    if solids.table.shape[0] > 0:
        up = wp.transpose(poses.geom_xmat[env, solids.table[0].geom])[2]
        plain = _lit(solids, solids.table[0], eye.turn * up, scratch)
    table = solids.faces.shape[0]
    pixels = eye.size * eye.size
    colour, depth, geom = (
        (lens.colour * frames.count + env) * pixels,
        (lens.depth * frames.count + env) * pixels,
        (lens.geom * frames.count + env) * pixels,
    )
    for row in range(eye.size):
        start = slope[0] * 0.5 + slope[1] * (float(row) + 0.5) + slope[2]
        for column in range(eye.size):
            pixel = row * eye.size + column
            nearness = start + slope[0] * float(column)
            face = wp.where(nearness > 0.0, table, table + 1)
            seen = wp.where(nearness > 0.0, plain, nothing)
            if scratch.nearness[pixel] > wp.max(nearness, 0.0):
                nearness = scratch.nearness[pixel]
                face = scratch.face[pixel]
                if lens.colour >= 0:
                    normal = _normal(
                        solids, face, float(column) + 0.5, float(row) + 0.5, eye, scratch
                    )
                    seen = _lit(solids, solids.solids[solids.owners[face]], normal, scratch)
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
    size: int,
    first: int,
    last: int,
):
    """Draw environments ``first`` to ``last`` (excluded) through every lens, ``size`` px wide.

    One thread draws them all, one after the other, in the same scratch buffers.
    """
    for env in range(first, last):
        for view in range(lenses.shape[0]):
            lens = lenses[view]
            eye = eye_of(poses, lens, env, size)
            for index in range(solids.solids.shape[0]):
                draw_solid(solids, index, poses, env, eye, scratch)
            expose(solids, poses, lens, env, eye, scratch, frames)
