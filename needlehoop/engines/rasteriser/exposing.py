"""From the desk to the film: what each pixel sees, lit.

As mujoco_warp's ray tracer shades: ambient and diffuse light, no shadows, no highlights.
"""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

from needlehoop.engines.rasteriser.desk import Desk, Eye, Film, Lens, Poses, slope_of
from needlehoop.engines.rasteriser.solids import Solid, Solids


@wp.func
def _lit(solids: Solids, solid: Solid, normal: wp.vec3, desk: Desk) -> wp.uint32:
    """Colour of a surface with a normal in the camera frame."""
    light = solid.ambient
    for lamp in range(solids.lamps.shape[0]):
        light += wp.max(wp.dot(normal, desk.lamps[lamp]), 0.0) * solids.lamps[lamp]
    red, green, blue = (
        int(255.0 * wp.clamp(solid.colour[0] * light[0], 0.0, 1.0)),
        int(255.0 * wp.clamp(solid.colour[1] * light[1], 0.0, 1.0)),
        int(255.0 * wp.clamp(solid.colour[2] * light[2], 0.0, 1.0)),
    )
    return wp.uint32((255 << 24) | (red << 16) | (green << 8) | blue)


@wp.func
def _normal(solids: Solids, face: int, x: float, y: float, eye: Eye, desk: Desk) -> wp.vec3:
    """Unit normal of a face in the camera frame where a pixel sees it, turned to the camera."""
    corners = solids.faces[face]
    a, b, c = desk.corners[corners[0]], desk.corners[corners[1]], desk.corners[corners[2]]
    pixel = wp.vec3(x, y, 1.0)
    # The signed areas of the parts that the pixel divides the face into, all of one sign.
    blend = (
        wp.dot(wp.cross(b, c), pixel) * solids.normals[3 * face]
        + wp.dot(wp.cross(c, a), pixel) * solids.normals[3 * face + 1]
        + wp.dot(wp.cross(a, b), pixel) * solids.normals[3 * face + 2]
    )
    normal = wp.normalize(desk.turns[solids.owners[face]] * blend)
    ray = wp.vec3(x - eye.centre, y - eye.centre, eye.focal)
    return wp.where(wp.dot(normal, ray) > 0.0, -normal, normal)


@wp.func
def _light_lamps(solids: Solids, poses: Poses, env: int, eye: Eye, desk: Desk):
    lights = solids.lights.shape[0]
    for light in range(lights):
        desk.lamps[light] = -(eye.turn * poses.light_xdir[env, solids.lights[light]])
    # The headlight shines along the optical axis.
    desk.lamps[lights] = wp.vec3(0.0, 0.0, -1.0)


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
def expose(solids: Solids, poses: Poses, lens: Lens, env: int, eye: Eye, desk: Desk, film: Film):
    """Take the images from the desk, with the table behind the solids, and clear it."""
    _light_lamps(solids, poses, env, eye, desk)
    slope = _table(solids, poses, env, eye)
    nothing = wp.uint32(255 << 24)
    plain = nothing
    if solids.table.shape[0] > 0:
        up = wp.transpose(poses.geom_xmat[env, solids.table[0].geom])[2]
        plain = _lit(solids, solids.table[0], eye.turn * up, desk)
    table = solids.faces.shape[0]
    pixels = eye.size * eye.size
    colour, depth, geom = (
        (lens.colour * film.count + env) * pixels,
        (lens.depth * film.count + env) * pixels,
        (lens.geom * film.count + env) * pixels,
    )
    for row in range(eye.size):
        start = slope[0] * 0.5 + slope[1] * (float(row) + 0.5) + slope[2]
        for column in range(eye.size):
            pixel = row * eye.size + column
            nearness = start + slope[0] * float(column)
            face = wp.where(nearness > 0.0, table, table + 1)
            seen = wp.where(nearness > 0.0, plain, nothing)
            if desk.nearness[pixel] > wp.max(nearness, 0.0):
                nearness = desk.nearness[pixel]
                face = desk.face[pixel]
                if lens.colour >= 0:
                    normal = _normal(solids, face, float(column) + 0.5, float(row) + 0.5, eye, desk)
                    seen = _lit(solids, solids.solids[solids.owners[face]], normal, desk)
            desk.nearness[pixel] = 0.0
            if lens.colour >= 0:
                film.colour[colour + pixel] = seen
            if lens.depth >= 0:
                film.depth[depth + pixel] = wp.where(nearness > 0.0, 1.0 / nearness, 0.0)
            if lens.geom >= 0:
                film.geom[geom + pixel] = solids.geoms[face]
