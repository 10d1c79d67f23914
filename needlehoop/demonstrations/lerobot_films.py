"""The films of LeRobot's layout: colours near to lossless, depth to the step of the camera.

A film of depth holds codes of 12 bits without loss, and its description says which depths they
stand for. This is LeRobot's own way, which its release 0.6 brought.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import imageio_ffmpeg
import numpy as np

from needlehoop.demonstrations.episodes import Demonstration
from needlehoop.envs.settings import Settings
from needlehoop.scene.image_size import ImageSize, extent, sides

_PREFIX, _DEPTH = "observation.images.", "_depth"
"""A film's key is the camera's name between them, or after the first."""

_LAST_CODE = 4095

_ORDER = ["-g", "2", "-bf", "0"]
"""Every second frame can be jumped to; frames are in the order of their times."""

# No quality: each film sets its own. Blocks of one pixel: nothing is scaled.
_BOTH: dict[str, Any] = {"quality": None, "macro_block_size": 1}
_COLOUR: dict[str, Any] = {
    **_BOTH,
    "pix_fmt_in": "rgb24",
    # At full resolution: halved, as is usual, a thing two pixels wide bleeds into black.
    "pix_fmt_out": "yuv444p",
    "codec": "libx264",
    # Near to lossless.
    "output_params": ["-crf", "12", *_ORDER],
}
_GREY: dict[str, Any] = {
    **_BOTH,
    "pix_fmt_in": "gray12le",
    "pix_fmt_out": "gray12le",
    "codec": "libx265",
    "output_params": ["-x265-params", "lossless=1:log-level=error", *_ORDER],
}


class Span(NamedTuple):
    """Depths of a camera, m: the least has the code 0, the greatest the last one."""

    near: float
    far: float


def spans(settings: Settings) -> dict[str, Span]:
    """The depths in each film of depth, by key; ``ValueError`` for images too small for one."""
    depths = {
        f"{_PREFIX}{camera.name}{_DEPTH}": Span(view.near, view.far)
        for camera in settings.cameras
        for view in [settings.views[camera.view]]
        if settings.renderings[camera.rendering].depth == "channel"
    }
    # The codec of depth takes no smaller ones.
    size = settings.image_size
    if depths and min(sides(size)) < 16:
        raise ValueError(
            f"image_size: {extent(size)}; LeRobot's films of depth need at least 16 pixels"
        )
    return depths


def streams(episode: Demonstration, depths: Mapping[str, Span]) -> dict[str, np.ndarray]:
    """What the films show, by key; what was seen after the last step is left out.

    Colours ``(t, h, w, 3)`` uint8; depth ``(t, h, w, 1)`` float32, m.
    """
    films = {}
    for name, images in episode.images.items():
        key, seen = f"{_PREFIX}{name}", images[:-1]
        if seen.shape[-1] >= 3:
            films[key] = seen[..., :3]
        if span := depths.get(key + _DEPTH):
            # The camera's channel is 255 at its near depth and 0 at its far depth.
            depth = span.far - seen[..., -1:] / 255 * (span.far - span.near)
            films[key + _DEPTH] = depth.astype(np.float32)
    return films


@contextmanager
def film(
    path: Path, size: ImageSize, rate: int, span: Span | None
) -> Iterator[Callable[[np.ndarray], None]]:
    """Adds images to a film; ``span``: its depths, ``None`` for colours."""
    kind = _COLOUR if span is None else _GREY
    frames = imageio_ffmpeg.write_frames(str(path), sides(size), fps=rate, **kind)

    def add(images: np.ndarray) -> None:
        if span is not None:
            share = (images - span.near) / (span.far - span.near)
            images = np.rint(share * _LAST_CODE).astype("<u2")
        for image in images:
            frames.send(np.ascontiguousarray(image))

    with closing(frames):
        # Begins the film.
        frames.send(None)
        yield add


def description(size: ImageSize, rate: int, span: Span | None) -> dict[str, Any]:
    """What the dataset's metadata say of a film, in LeRobot's words; as in ``film``."""
    is_depth, (width, height) = span is not None, sides(size)
    fields: dict[str, Any] = {
        "video.height": height,
        "video.width": width,
        "video.channels": 1 if is_depth else 3,
        "video.codec": "hevc" if is_depth else "h264",
        "video.pix_fmt": (_GREY if is_depth else _COLOUR)["pix_fmt_out"],
        "video.fps": rate,
        "has_audio": False,
        "is_depth_map": is_depth,
        # Its name before LeRobot 0.6.
        "video.is_depth_map": is_depth,
    }
    if span is not None:
        fields |= {
            "video.depth_min": span.near,
            "video.depth_max": span.far,
            "video.use_log": False,
            "video.shift": 0.0,
            "video.extra_options": {"x265-params": "lossless=1"},
            # Of the statistics.
            "depth_unit": "m",
        }
    return fields
