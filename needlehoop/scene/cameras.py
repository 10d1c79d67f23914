"""Cameras: a view (where it stands) crossed with a rendering (what it sees)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, NamedTuple

import mujoco
import numpy as np

from needlehoop.config.strict import Range, check_names

Place = Annotated[float, Range(-100.0, 100.0)]
"""A coordinate, m."""

Point = tuple[Place, Place, Place]

Shade = Annotated[int, Range(0, 255)]


class Orbit(NamedTuple):
    """A place from which a camera looks at a target; see ``View``."""

    target: Point
    azimuth: float
    elevation: float
    distance: float


_POSE = ("position", "forward", "up")


@dataclass(frozen=True, kw_only=True)
class View:
    """Where a camera stands; values in ``conf/view``. Angles in degrees, lengths in m.

    It is placed in one of two ways, in the frame of its ``body``:

    - ``target``, ``azimuth``, ``elevation``, ``distance``: it looks at the target. The azimuth is
      about z: 0 is the front (at -y), 90 is the left (at -x).
    - ``position``, ``forward``, ``up``: where it is, where it looks, and which way is up in its
      image. The last two need be neither of length 1 nor at right angles.
    """

    target: Point | None = None
    azimuth: Annotated[float, Range(-360.0, 360.0)] | None = None
    elevation: Annotated[float, Range(-89.9, 89.9)] | None = None
    distance: Annotated[float, Range(0.0, 100.0, above=True)] | None = None
    position: Point | None = None
    forward: Point | None = None
    up: Point | None = None
    fovy: Annotated[float, Range(0.1, 179.0)]
    near: float
    far: Annotated[float, Range(0.0, 1e4, above=True)]
    """Depths that the depth channel maps to 255 and to 0, m along the optical axis."""
    body: str | None = None
    """The body that it is mounted on, and moves with; ``None``: it stands in the room."""
    roll: Annotated[float, Range(-360.0, 360.0)] = 0.0
    """Turns it anticlockwise about its line of sight."""

    def __post_init__(self) -> None:
        ways = (Orbit._fields, _POSE)
        place = tuple(key for keys in ways for key in keys if getattr(self, key) is not None)
        if place not in ways:
            either = " or ".join(", ".join(keys) for keys in ways)
            raise ValueError(f"view: {', '.join(place) or 'no place'} given; give either {either}")
        if self.forward and self.up and not np.cross(self.forward, self.up).any():
            raise ValueError(f"view.up: {self.up} is zero or along forward={self.forward}")
        if not 0 < self.near < self.far:
            raise ValueError(f"view.near: {self.near} must lie between 0 and far={self.far}")

    @property
    def given(self) -> dict[str, Any]:
        """Its keys and values, as a file has them: without defaults."""
        pairs = {field.name: (getattr(self, field.name), field.default) for field in fields(self)}
        return {key: value for key, (value, default) in pairs.items() if value != default}

    @property
    def orbit(self) -> Orbit | None:
        """Where it is if it is placed about a target."""
        place = (self.target, self.azimuth, self.elevation, self.distance)
        return None if any(one is None for one in place) else Orbit(*place)  # pyright: ignore

    @property
    def focus(self) -> np.ndarray:
        """The target, or the middle of its depths ``(3,)``, m, in the frame of its body."""
        if self.target is not None:
            return np.asarray(self.target)
        position, quaternion = pose_of(self)
        return position + (self.near + self.far) / 2 * line_of_sight(quaternion)


@dataclass(frozen=True)
class Rendering:
    """What a camera reports; values in ``conf/rendering``."""

    colour: str
    """``rgb``: lit materials. ``flat``: one of ``colours`` per class of object. ``none``."""
    depth: str
    """``channel``: a channel of its own. ``shade``: colours get darker with depth. ``none``."""
    colours: Mapping[str, tuple[Shade, Shade, Shade]]

    def __post_init__(self) -> None:
        check_names("rendering.colour", [self.colour], ("rgb", "flat", "none"))
        check_names("rendering.depth", [self.depth], ("channel", "shade", "none"))
        if self.channels == 0:
            raise ValueError("rendering.colour: nothing to render; give a colour or depth=channel")

    @property
    def channels(self) -> int:
        """Channels of the image."""
        return 3 * (self.colour != "none") + (self.depth == "channel")


@dataclass(frozen=True)
class Camera:
    """A chosen combination, named ``<rendering>_<view>``."""

    name: str
    view: str
    rendering: str


def parse_cameras(
    names: Iterable[str], views: Iterable[str], renderings: Iterable[str]
) -> tuple[Camera, ...]:
    """Cameras by name, e.g. ``dep_front``.

    Raises:
        ValueError: a name that is not ``<rendering>_<view>``, or given twice.
    """
    views, renderings = sorted(views), sorted(renderings)
    cameras: list[Camera] = []
    for name in names:
        rendering, separator, view = str(name).partition("_")
        if not separator:
            raise ValueError(
                f"cams: {name!r} is not <rendering>_<view>; renderings: {', '.join(renderings)};"
                f" views: {', '.join(views)}"
            )
        check_names(f"cams: {name!r}: rendering", [rendering], renderings)
        check_names(f"cams: {name!r}: view", [view], views)
        if any(camera.name == name for camera in cameras):
            raise ValueError(f"cams: {name!r} is named twice")
        cameras.append(Camera(name, view, rendering))
    return tuple(cameras)


def in_rows(cameras: Sequence[Camera], views: Mapping[str, View]) -> list[tuple[Camera, ...]]:
    """Cameras as they are shown, row by row: one, or the left and the right eye of a stereo camera.

    Eyes need the same rendering. A row stands where its first camera stood.
    """
    rows, left = [], list(cameras)
    while left:
        first = left.pop(0)
        same = [other for other in left if other.rendering == first.rendering]
        pairs = [pair for other in same for pair in ((first, other), (other, first))]
        row = next((pair for pair in pairs if _are_eyes(*pair, views)), (first,))
        rows.append(row)
        left = [camera for camera in left if camera not in row]
    return rows


def _are_eyes(first: Camera, second: Camera, views: Mapping[str, View]) -> bool:
    """Whether the first is the left eye and the second the right one of a stereo camera.

    They look the same way from the same body, and the second stands straight to the right.
    """
    left, right = views[first.view], views[second.view]
    (here, turn), (there, same_turn) = pose_of(left), pose_of(right)
    way, across = there - here, _right_of(turn)
    alike = (left.body, left.fovy) == (right.body, right.fovy) and np.allclose(turn, same_turn)
    # To a micrometre.
    is_right = bool(way @ across > 1e-6)
    return alike and is_right and np.allclose(way, way @ across * across, atol=1e-6)


def pose_of(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Position ``(3,)`` in m and quaternion ``(4,)`` (w, x, y, z) of a view's camera.

    In the frame of its body. A MuJoCo camera looks along its -z, with y up.
    """
    if view.orbit is None:
        position, quaternion = np.asarray(view.position), _facing(view.forward, view.up)
    else:
        position, quaternion = _on_orbit(view.orbit)
    if view.roll:
        half = np.deg2rad(view.roll) / 2
        c, s, (w, x, y, z) = np.cos(half), np.sin(half), quaternion
        quaternion = np.array([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s])
    return position, quaternion


def _on_orbit(orbit: Orbit) -> tuple[np.ndarray, np.ndarray]:
    """The pose that looks at the target with z up."""
    azimuth, elevation = np.deg2rad(orbit.azimuth), np.deg2rad(orbit.elevation)
    outward = np.array(
        [
            -np.sin(azimuth) * np.cos(elevation),
            -np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    position = np.asarray(orbit.target) + orbit.distance * outward
    # Turned up from looking straight down, then about the vertical.
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, [-azimuth, np.pi / 2 - elevation, 0.0], "zxz")
    return position, quaternion


def _facing(forward: Any, up: Any) -> np.ndarray:
    """The quaternion of a camera that looks along ``forward``, with ``up`` up in its image."""
    back = -np.asarray(forward) / np.linalg.norm(forward)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    (a, b, c), (d, e, f), (g, h, i) = np.stack((right, np.cross(back, right), back), 1)
    # Four times the products of the quaternion's parts with one another, plus the identity.
    products = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    ) + np.eye(4)
    largest = products[np.diagonal(products).argmax()]
    return largest / np.linalg.norm(largest)


def line_of_sight(quaternion: np.ndarray) -> np.ndarray:
    """The direction ``(3,)`` in which a camera looks, of length 1."""
    w, x, y, z = quaternion
    return -np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def _right_of(quaternion: np.ndarray) -> np.ndarray:
    """The direction ``(3,)`` to the right in a camera's image, of length 1."""
    w, x, y, z = quaternion
    return np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
