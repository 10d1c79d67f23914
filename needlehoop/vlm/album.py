"""The pictures that a model is shown. They are drawn once and kept beside the record."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps
from pydantic import TypeAdapter

from needlehoop.envs.settings import Settings
from needlehoop.pictures.stills import stages, to_rgb
from needlehoop.runs.files import write_whole
from needlehoop.scene.cameras import Rendering
from needlehoop.scene.image_size import ImageSize, scaled_to, sides
from needlehoop.vlm import description
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.record import Record

_AT_AGENTS_SIZE = "seen"
"""In ``pictures.json``: what ``Album.at_agents_size`` has."""

_KINDS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Album:
    """All cameras' pictures of the stages of one episode; the agent's images have ``pixels``.

    They are kept because their bytes are part of a request. Another machine may draw a pixel
    differently, and its requests would then match no recorded answer.
    """

    stages: Mapping[str, Mapping[str, Png]]
    """By stage (see ``description.stages_of``) and camera."""
    at_agents_size: Mapping[str, Png]
    """Two stages again, side by side, at the agent's own resolution, by camera."""
    pixels: ImageSize

    def renamed(self, names: Sequence[str]) -> Album:
        """The same pictures, with other names of the stages, in their order."""
        return replace(self, stages=dict(zip(names, self.stages.values(), strict=True)))

    def show(self, cameras: Sequence[str], *stages: str) -> list[Part]:
        """Pictures, stage by stage (all, or ``stages``), each after a line that names it."""
        return [
            part
            for stage in stages or self.stages
            for camera in cameras
            for part in (f"{camera}, {stage}:", self.stages[stage][camera])
        ]

    def show_at_agents_size(self, cameras: Sequence[str]) -> list[Part]:
        """Two stages at the agent's own resolution, enlarged."""
        (width, height), two = sides(self.pixels), ", ".join(_first_and_late([*self.stages]))
        caption = f"as the agent sees it, {width} x {height} pixels (enlarged), {two}:"
        small = self.at_agents_size
        return [part for camera in cameras for part in (f"{camera} {caption}", small[camera])]


def _first_and_late(stages: Sequence[str]) -> tuple[str, str]:
    """The first stage, and the one before the goal (the goal itself, if there are only two)."""
    return stages[0], stages[-2 if len(stages) > 2 else -1]


def open_album(record: Record, settings: Settings, size: int) -> Album:
    """The pictures of all cameras, their longer side ``size`` pixels; drawn if the record has none.

    ``ValueError``: disturbed cameras, or the record shows another scene; else as in ``stages``.
    """
    if settings.disturb.amounts:
        raise ValueError(
            "disturb: a model is told that its pictures are free of noise; choose disturb=none"
        )
    of = ("task", "episode", "psm", "renderings", "seed", "quality", "image_size")
    values = {**{name: getattr(settings, name) for name in of}, "size": size}
    values["views"] = {name: view.given for name, view in settings.views.items()}
    # Everything that the pictures depend on, as plain JSON values.
    scene = TypeAdapter(dict[str, Any]).dump_python(values, mode="json")
    path = record.folder / "pictures.json"
    if not path.exists():
        hashes = {
            stage: {camera: record.save(picture) for camera, picture in shown.items()}
            for stage, shown in _take(settings, size).items()
        }
        text = json.dumps({"scene": scene, "pictures": hashes}, indent=2)
        write_whole(path, text + "\n")
    kept = json.loads(path.read_text())
    if kept["scene"] != scene:
        odd = [key for key in scene if kept["scene"].get(key) != scene[key]]
        raise ValueError(
            f"{path} shows another scene (its {', '.join(odd)} differs); give the settings it"
            " was made with, or choose another study="
        )
    pictures = {
        stage: {camera: record.picture(sha256) for camera, sha256 in shown.items()}
        for stage, shown in kept["pictures"].items()
    }
    return Album(pictures, pictures.pop(_AT_AGENTS_SIZE), settings.image_size)


def _take(settings: Settings, size: int) -> dict[str, dict[str, Png]]:
    cameras = tuple(f"{r}_{view}" for r in settings.renderings for view in settings.views)
    alone = replace(settings, cams=cameras, num_envs=1)
    kinds = {camera.name: settings.renderings[camera.rendering] for camera in alone.cameras}
    shown = [*description.stages_of(settings.definition)]
    large = replace(alone, image_size=scaled_to(settings.image_size, size))
    taken, seen = stages(large, *shown), stages(alone, *_first_and_late(shown))
    # Each pixel is repeated, to come as near as possible to the other pictures' size.
    times = max(1, round(size / max(sides(settings.image_size))))
    pictures: dict[str, dict[str, Png]] = {stage: {} for stage in (*shown, _AT_AGENTS_SIZE)}
    for name in cameras:
        for stage in shown:
            picture = all_channels(taken[stage][name], kinds[name])
            pictures[stage][name] = Png.of(Image.fromarray(picture))
        small = (
            seen[stage][name].repeat(times, 1).repeat(times, 2) for stage in _first_and_late(shown)
        )
        pair = _side_by_side(*(all_channels(image, kinds[name]) for image in small))
        pictures[_AT_AGENTS_SIZE][name] = Png.of(Image.fromarray(pair))
    return pictures


def all_channels(image: np.ndarray, rendering: Rendering) -> np.ndarray:
    """An agent's image ``(channels, h, w)`` as a picture ``(h, w', 3)`` with all its channels.

    A depth channel is shown in grey, to the right of the colours.
    """
    shown = to_rgb(image, rendering.depth)
    if rendering.depth != "channel" or rendering.colour == "none":
        return shown
    return _side_by_side(to_rgb(image[:3], "none"), shown)


def _side_by_side(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Two pictures ``(h, w, 3)`` with a white gap between them, a 48th of their height wide."""
    gap = np.full((len(first), max(1, len(first) // 48), 3), 255, np.uint8)
    return np.concatenate([first, gap, second], axis=1)


def read_folder(folder: Path, about: str | None, size: int) -> tuple[dict[str, Png], str]:
    """The pictures by their files' names, and what the task is: ``about``, or else ``about.txt``.

    ``size``: pixels of a picture's longer side, at most. ``ValueError``: fewer than two pictures.
    """
    if not folder.is_dir():
        raise ValueError(f"pictures: {folder} is no folder")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _KINDS)
    if len({file.stem for file in files}) < max(2, len(files)):
        raise ValueError(
            f"pictures: {folder} must have two or more pictures ({', '.join(_KINDS)}) of different"
            f" names; it has: {', '.join(file.name for file in files) or 'none'}"
        )
    pictures, text = {}, folder / "about.txt"
    if about is None:
        about = text.read_text() if text.exists() else ""
    for file in files:
        with Image.open(file) as opened:
            # A telephone notes which way is up, and where it was taken, which is left out.
            upright = ImageOps.exif_transpose(opened).convert("RGB")
        pictures[file.stem] = Png.of(upright, size)
    return pictures, about.strip()
