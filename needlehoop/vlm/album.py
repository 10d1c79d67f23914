"""The pictures that a model is shown: taken once, kept beside the transcript."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from PIL import Image

from needlehoop.envs.settings import Settings
from needlehoop.pictures.sheet import start_and_goal, to_rgb
from needlehoop.runs.run import Run
from needlehoop.vlm.messages import Part, Picture
from needlehoop.vlm.transcript import Transcript

PICTURES = "pictures.json"
STATES = ("start", "goal")


class Album:
    """All cameras' pictures of one episode's start and goal.

    They are kept because their bytes are part of what is asked: another machine may draw
    a pixel differently, and would then find no recorded answer.

    Args:
        pictures: by state (``start``, ``goal``) and camera.
    """

    def __init__(self, pictures: Mapping[str, Mapping[str, Picture]]):
        self._pictures = pictures

    def show(self, state: str, cameras: Sequence[str]) -> list[Part]:
        """Pictures, each after a line that says what it is."""
        parts: list[Part] = []
        for camera in cameras:
            parts += [f"{camera}, {state}:", self._pictures[state][camera]]
        return parts


def open_album(transcript: Transcript, settings: Settings, size: int) -> Album:
    """The pictures of a record, or, where it has none yet, new ones.

    Args:
        transcript: beside which they are kept.
        settings: the scene; its own cameras are ignored.
        size: pixels.

    Raises:
        ValueError: the record shows another scene, or ``size`` is below 16.
        RuntimeError: the expert did not reach the goal state.
    """
    if size < 16:
        raise ValueError(f"size: {size} must be at least 16")
    index, scene = transcript.folder / PICTURES, _scene(settings, size)
    if not index.exists():
        pictures = _take(settings, size)
        names = {
            state: {camera: picture.sha256 for camera, picture in shown.items()}
            for state, shown in pictures.items()
        }
        for shown in pictures.values():
            for picture in shown.values():
                transcript.save(picture)
        text = json.dumps({"scene": scene, "pictures": names}, indent=2)
        Run(transcript.folder).write(PICTURES, text + "\n")
        return Album(pictures)
    kept = json.loads(index.read_text())
    if kept["scene"] != scene:
        odd = [key for key in scene if kept["scene"].get(key) != scene[key]]
        raise ValueError(
            f"{index} shows another scene (its {', '.join(odd)} differs); give the settings it"
            " was made with, or choose another study="
        )
    return Album(
        {
            state: {camera: transcript.picture(sha256) for camera, sha256 in shown.items()}
            for state, shown in kept["pictures"].items()
        }
    )


def _scene(settings: Settings, size: int) -> dict[str, Any]:
    """Everything that the pictures depend on, as plain JSON values."""
    s = settings
    values = {
        "task": asdict(s.task),
        "episode": asdict(s.episode),
        "psm": s.psm,
        "views": {name: asdict(view) for name, view in s.views.items()},
        "renderings": {
            name: {"colour": r.colour, "depth": r.depth, "colours": dict(r.colours)}
            for name, r in s.renderings.items()
        },
        "seed": s.seed,
        "quality": s.quality,
        "size": size,
    }
    return json.loads(json.dumps(values))


def _take(settings: Settings, size: int) -> dict[str, dict[str, Picture]]:
    cameras = tuple(f"{r}_{view}" for r in settings.renderings for view in settings.views)
    s = replace(settings, cams=cameras, image_size=size, num_envs=1)
    depths = {camera.name: s.renderings[camera.rendering].depth for camera in s.cameras}
    return {
        state: {name: _png(to_rgb(image, depths[name])) for name, image in images.items()}
        for state, images in zip(STATES, start_and_goal(s), strict=True)
    }


def _png(image: np.ndarray) -> Picture:
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, "PNG")
    return Picture(file.getvalue())
