"""The kernel that draws: solids into the scratch buffers, and from there lit images."""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

from needlehoop.engines.rasteriser.buffers import (
    PATTERN,
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
def _packed(colour: wp.vec3) -> wp.uint32:
    red, green, blue = (
        int(255.0 * wp.clamp(colour[0], 0.0, 1.0)),
        int(255.0 * wp.clamp(colour[1], 0.0, 1.0)),
        int(255.0 * wp.clamp(colour[2], 0.0, 1.0)),
    )
    return wp.uint32((255 << 24) | (red << 16) | (green << 8) | blue)


@wp.func
def _lit(solids: Solids, solid: Solid, normal: wp.vec3, scratch: ScratchBuffers) -> wp.uint32:
    """Colour of a surface with a normal in the camera frame."""
    light = solid.ambient
    for lamp in range(solids.lamps.shape[0]):
        light += wp.max(wp.dot(normal, scratch.lamps[lamp]), 0.0) * solids.lamps[lamp]
    return _packed(wp.cw_mul(solid.colour, light))


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
def _relit(
    solids: Solids,
    solid: Solid,
    normal: wp.vec3,
    ray: wp.vec3,
    poses: Poses,
    env: int,
    scratch: ScratchBuffers,
) -> wp.vec3:
    """``_lit`` under ``OPTICS``: with a tint, a sheen, and lamps of another strength.

    Args:
        solids: with the lamps.
        solid: whose surface it is.
        normal: of the surface, camera frame.
        ray: from the camera to it.
        poses: with the optics.
        env: which environment.
        scratch: with directions to the lamps.
    """
    strength = poses.lamp_strength[env, 0]
    sheen = poses.geom_sheen[env, solid.geom]
    light = solid.ambient
    gloss = float(0.0)  # noqa: UP018 - Warp takes a bare number for a constant
    for lamp in range(solids.lamps.shape[0]):
        towards = scratch.lamps[lamp]
        light += wp.max(wp.dot(normal, towards), 0.0) * strength * solids.lamps[lamp]
        if sheen > 0.0:
            half = wp.normalize(towards - wp.normalize(ray))
            # To the 16th power: how narrow highlights are.
            shine = wp.max(wp.dot(normal, half), 0.0)
            shine = shine * shine * shine * shine
            gloss += shine * shine * shine * shine * solids.lamps[lamp][0]
    gloss = strength * sheen * gloss
    lit = wp.cw_mul(wp.cw_mul(solid.colour, poses.geom_tint[env, solid.geom]), light)
    return lit + wp.vec3(gloss, gloss, gloss)


@wp.func
def _grain(
    ray: wp.vec3, nearness: float, eye: Eye, grain: wp.vec3, pattern: wp.array2d[float]
) -> float:
    """Factor of the table's colour where a ray meets it: smooth noise over the table.

    Args:
        ray: from the camera, world frame, 1 long along the optical axis.
        nearness: 1/z of the table there.
        eye: who looks.
        grain: how strong, where the pattern begins, and its cells to a m.
        pattern: numbers in [-1, 1].
    """
    at = eye.position + ray / nearness
    row = (int(wp.floor(at[1] * grain[2])) + int(grain[1])) & (PATTERN - 1)
    column = (int(wp.floor(at[0] * grain[2])) + int(grain[1])) & (PATTERN - 1)
    return 1.0 + grain[0] * pattern[row, column]


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

    As mujoco_warp's ray tracer shades: ambient and diffuse light, no shadows, no highlights,
    but for what the ``OPTICS`` say.
    """
    relit, grain = poses.relit[env], poses.table_grain[env, 0]
    relit_table = wp.vec3(0.0, 0.0, 0.0)
    _light_lamps(solids, poses, env, eye, scratch)
    slope = _table(solids, poses, env, eye)
    nothing = wp.uint32(255 << 24)
    plain = nothing
    if solids.table.shape[0] > 0:
        up = wp.transpose(poses.geom_xmat[env, solids.table[0].geom])[2]
        plain = _lit(solids, solids.table[0], eye.turn * up, scratch)
        # It is matte: one colour everywhere, but for its pattern.
        if relit == 1:
            flat = eye.turn * up
            relit_table = _relit(solids, solids.table[0], flat, flat, poses, env, scratch)
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
                if lens.colour >= 0 and relit == 0:
                    normal = _normal(
                        solids, face, float(column) + 0.5, float(row) + 0.5, eye, scratch
                    )
                    seen = _lit(solids, solids.solids[solids.owners[face]], normal, scratch)
            scratch.nearness[pixel] = 0.0
            if lens.colour >= 0 and relit == 1 and face <= table:
                x, y = float(column) + 0.5, float(row) + 0.5
                ray = wp.vec3((x - eye.centre) / eye.focal, (y - eye.centre) / eye.focal, 1.0)
                if face < table:
                    normal = _normal(solids, face, x, y, eye, scratch)
                    solid = solids.solids[solids.owners[face]]
                    seen = _packed(_relit(solids, solid, normal, ray, poses, env, scratch))
                elif grain[0] > 0.0:
                    turned = wp.transpose(eye.turn) * ray
                    seen = _packed(
                        _grain(turned, nearness, eye, grain, poses.pattern) * relit_table
                    )
                else:
                    seen = _packed(relit_table)
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
