"""What a pixel shows: the face or the table that it sees, in the light of the lamps."""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

from needlehoop.engines.rasteriser.buffers import PATTERN, Eye, Poses, ScratchBuffers, slope_of
from needlehoop.engines.rasteriser.solids import Solid, Solids


@wp.func
def packed(colour: wp.vec3) -> wp.uint32:
    red, green, blue = (
        int(255.0 * wp.clamp(colour[0], 0.0, 1.0)),
        int(255.0 * wp.clamp(colour[1], 0.0, 1.0)),
        int(255.0 * wp.clamp(colour[2], 0.0, 1.0)),
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
def _lit(
    solids: Solids,
    solid: Solid,
    normal: wp.vec3,
    ray: wp.vec3,
    poses: Poses,
    env: int,
    scratch: ScratchBuffers,
) -> wp.vec3:
    """Colour of a surface, with the tint, the sheen and the strength of lamps of the ``OPTICS``.

    ``normal`` and ``ray``, from the camera to it, are in the camera frame.
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

    The ``ray`` is in the world frame, 1 long along the optical axis; ``nearness``: 1/z there;
    ``grain``: how strong the pattern is, where it begins, its cells to a m.
    """
    at = eye.position + ray / nearness
    row = (int(wp.floor(at[1] * grain[2])) + int(grain[1])) & (PATTERN - 1)
    column = (int(wp.floor(at[0] * grain[2])) + int(grain[1])) & (PATTERN - 1)
    return 1.0 + grain[0] * pattern[row, column]


@wp.func
def light_lamps(solids: Solids, poses: Poses, env: int, eye: Eye, scratch: ScratchBuffers):
    lights = solids.lights.shape[0]
    for light in range(lights):
        scratch.lamps[light] = -(eye.turn * poses.light_xdir[env, solids.lights[light]])
    # The headlight shines along the optical axis.
    scratch.lamps[lights] = wp.vec3(0.0, 0.0, -1.0)


@wp.func
def table_slope(solids: Solids, poses: Poses, env: int, eye: Eye) -> wp.vec3:
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
def table_colour(
    solids: Solids, poses: Poses, env: int, eye: Eye, scratch: ScratchBuffers
) -> wp.vec3:
    """Of the table, which is matte: the same everywhere, but for its pattern."""
    if solids.table.shape[0] == 0:
        return wp.vec3(0.0, 0.0, 0.0)
    up = eye.turn * wp.transpose(poses.geom_xmat[env, solids.table[0].geom])[2]
    return _lit(solids, solids.table[0], up, up, poses, env, scratch)


@wp.func
def seen_colour(
    solids: Solids,
    poses: Poses,
    env: int,
    eye: Eye,
    scratch: ScratchBuffers,
    face: int,
    nearness: float,
    flat: wp.vec3,
    x: float,
    y: float,
) -> wp.uint32:
    """What a pixel shows that sees a ``face``; ``flat``: the table's colour."""
    table = solids.faces.shape[0]
    if face > table:
        return wp.uint32(255 << 24)
    ray = wp.vec3((x - eye.centre) / eye.focal, (y - eye.centre) / eye.focal, 1.0)
    if face < table:
        normal = _normal(solids, face, x, y, eye, scratch)
        solid = solids.solids[solids.owners[face]]
        return packed(_lit(solids, solid, normal, ray, poses, env, scratch))
    grain = poses.table_grain[env, 0]
    if grain[0] > 0.0:
        turned = wp.transpose(eye.turn) * ray
        return packed(_grain(turned, nearness, eye, grain, poses.pattern) * flat)
    return packed(flat)
