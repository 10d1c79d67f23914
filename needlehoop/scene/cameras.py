"""Cameras: a view (where it stands) crossed with a rendering (what it sees)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from needlehoop.config.strict import Range, check_names

Place = Annotated[float, Range(-100.0, 100.0)]
"""A coordinate, m."""

Shade = Annotated[int, Range(0, 255)]


@dataclass(frozen=True)
class View:
    """Where a camera stands; values in ``conf/view``.

    ``azimuth`` is measured about the world's z: 0 is the front (at -y), 90 is
    the left (at -x). Angles in degrees, lengths in m, ``target`` in the world frame.
    """

    target: tuple[Place, Place, Place]
    azimuth: Annotated[float, Range(-360.0, 360.0)]
    elevation: float
    distance: Annotated[float, Range(0.0, 100.0, above=True)]
    fovy: float
    near: float
    far: Annotated[float, Range(0.0, 1e4, above=True)]
    """Depths that the depth channel maps to 255 and to 0, m along the optical axis."""

    def __post_init__(self) -> None:
        if not 0 < self.fovy < 180:
            raise ValueError(f"view.fovy: {self.fovy} must lie in (0, 180) degrees")
        if not -90 < self.elevation < 90:
            raise ValueError(f"view.elevation: {self.elevation} must lie in (-90, 90) degrees")
        if not 0 < self.near < self.far:
            raise ValueError(f"view.near: {self.near} must lie between 0 and far={self.far}")


@dataclass(frozen=True)
class Rendering:
    """What a camera reports; values in ``conf/rendering``.

    ``colour`` is ``rgb`` (lit materials), ``flat`` (one colour per class of object, see
    ``colours``), or ``none``. ``depth`` is ``channel`` (a channel of its own), ``shade``
    (colours get darker with depth), or ``none``.
    """

    colour: str
    depth: str
    colours: Mapping[str, tuple[Shade, Shade, Shade]]

    def __post_init__(self) -> None:
        check_names("rendering.colour", [self.colour], ("rgb", "flat", "none"))
        check_names("rendering.depth", [self.depth], ("channel", "shade", "none"))
        if self.channels == 0:
            raise ValueError("rendering.colour: nothing to render; give a colour or depth=channel")
        if self.colour == "none" and self.depth == "shade":
            raise ValueError("rendering.depth: shade needs a colour; choose rgb or flat")
        if self.colour == "flat" and not self.colours:
            raise ValueError("rendering.colours: a flat rendering needs a colour per class")

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


def pose_of(view: View) -> tuple[np.ndarray, np.ndarray]:
    """World position ``(3,)`` in m and quaternion ``(4,)`` (w, x, y, z) of a view's camera.

    A MuJoCo camera looks along its -z, with y up.
    """
    azimuth, elevation = np.deg2rad(view.azimuth), np.deg2rad(view.elevation)
    outward = np.array(
        [
            -np.sin(azimuth) * np.cos(elevation),
            -np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    position = np.asarray(view.target) + view.distance * outward
    # Turned up from looking straight down, then about the vertical.
    tilt, turn = (np.pi / 2 - elevation) / 2, -azimuth / 2
    quaternion = np.array(
        [
            np.cos(turn) * np.cos(tilt),
            np.cos(turn) * np.sin(tilt),
            np.sin(turn) * np.sin(tilt),
            np.sin(turn) * np.cos(tilt),
        ]
    )
    return position, quaternion
