"""What the kernel works with: cameras, poses, scratch buffers, and buffers of finished images.

Points are projected to ``(x z, y z, z)``: pixels from the upper left corner of the image, times
the depth z in m along the optical axis. In these homogeneous coordinates the line through two
corners is their cross product, on either side of the camera's plane, so nothing is clipped. The
depth buffer holds 1/z, which over a plane is linear in x and y.

Columns are counted as in a square image of the same height; a narrower or wider image begins at
column ``left``, negative if wider. So the arithmetic is the same for all shapes.
"""

# Warp compiles this file; its types are not all Python's.
# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false
import warp as wp

PATTERN = wp.constant(128)
"""Cells of the table's pattern along a side."""


@wp.struct
class Lens:
    """What a view's camera is and which image of each kind it makes; -1 for none."""

    camera: int
    colour: int
    depth: int
    geom: int


@wp.struct
class Poses:
    """Fields of MjData ``(environments, objects)``."""

    geom_xpos: wp.array2d[wp.vec3]
    geom_xmat: wp.array2d[wp.mat33]
    cam_xpos: wp.array2d[wp.vec3]
    cam_xmat: wp.array2d[wp.mat33]
    light_xdir: wp.array2d[wp.vec3]
    cam_tangent: wp.array2d[float]
    """Of half the field of view, up and down."""
    geom_tint: wp.array2d[wp.vec3]
    geom_sheen: wp.array2d[float]
    lamp_strength: wp.array2d[float]
    table_grain: wp.array2d[wp.vec3]
    """This and the three before it are ``OPTICS``; see ``engines.contract``."""
    pattern: wp.array2d[float]
    """Of the table, ``(PATTERN, PATTERN)``, endless."""


@wp.struct
class Eye:
    """A camera at work."""

    position: wp.vec3
    """In the world, m."""
    turn: wp.mat33
    """From the world to the camera: x right, y down, z ahead."""
    tangent: float
    """Of half the field of view, up and down."""
    focal: float
    """Pixels to a tangent of 1."""
    centre: float
    """Of the square image, pixels."""
    width: int
    height: int
    """Of the image, pixels."""
    left: int
    """First column."""


@wp.struct
class ScratchBuffers:
    """One image while it is drawn."""

    corners: wp.array[wp.vec3]
    """Vertices, homogeneous."""
    points: wp.array[wp.vec2]
    """Vertices, pixels."""
    turns: wp.array[wp.mat33]
    """From each solid to the camera."""
    lamps: wp.array[wp.vec3]
    """Directions to the lights, camera frame."""
    nearness: wp.array[float]
    """1/z of each pixel, 1/m."""
    face: wp.array[int]
    """Index of the face that each pixel sees; after the last face come the table and nothing."""


@wp.struct
class FrameBuffers:
    """Finished images one after the other: by kind's index, by environment."""

    colour: wp.array[wp.uint32]
    """Blue in the lowest byte, then green, red, 255."""
    depth: wp.array[float]
    geom: wp.array[int]
    count: int
    """Images of an index."""


@wp.func
def eye_of(poses: Poses, lens: Lens, env: int, size: wp.vec2i) -> Eye:
    """``size``: width and height, pixels."""
    eye = Eye()
    eye.position = poses.cam_xpos[env, lens.camera]
    axes = wp.transpose(poses.cam_xmat[env, lens.camera])
    eye.turn = wp.matrix_from_rows(axes[0], -axes[1], -axes[2])
    eye.tangent = poses.cam_tangent[env, lens.camera]
    eye.centre = 0.5 * float(size[1])
    eye.focal = eye.centre / eye.tangent
    eye.width = size[0]
    eye.height = size[1]
    eye.left = (size[1] - size[0]) // 2
    return eye


@wp.func
def slope_of(normal: wp.vec3, distance: float, eye: Eye) -> wp.vec3:
    """1/z over a plane: its change per pixel to the right and down, its value at the corner.

    The plane's unit normal is in the camera frame, its distance from there along the normal in m;
    the corner is the square image's upper left one.
    """
    rise = normal / distance
    across, down = rise[0] / eye.focal, rise[1] / eye.focal
    return wp.vec3(across, down, rise[2] - eye.centre * (across + down))
