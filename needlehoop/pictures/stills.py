"""Pictures of the scene: a portrait, and the contact sheet of every view and rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from needlehoop.config import strict
from needlehoop.config.strict import Pixels
from needlehoop.engines.contract import FIELDS, Channels
from needlehoop.envs.build import PICTURE, build
from needlehoop.envs.controllers import controller
from needlehoop.envs.rollout import Step, rollout
from needlehoop.envs.settings import Settings

_OVERSAMPLING = 3
_AFTER_SUCCESS = 4
"""Steps from success to the goal picture, in which the goal is reached for all to see."""

_INK, _PAPER = (34, 38, 46), (255, 255, 255)


class Photographer:
    """Takes pictures of one MjData from the ``picture`` camera.

    Args:
        model: a compiled scene.
        size: pixels.

    Raises:
        ValueError: a size below 1 or above 4096.
    """

    def __init__(self, model: mujoco.MjModel, size: int):
        strict.structure(size, Pixels, "size")
        # Imported where it is used: mujoco_warp takes two seconds.
        from needlehoop.engines.tracer import Tracer

        self._tracer = Tracer(model, 1, {PICTURE: Channels(True, False, False)}, size, 1, 2)

    def __call__(self, data: mujoco.MjData) -> np.ndarray:
        """The scene as ``(size, size, 3)`` uint8."""
        fields = {name: getattr(data, name)[None] for name in FIELDS}
        frame = self._tracer.render(fields)[PICTURE]
        assert frame.bgra is not None
        return frame.bgra[0, ..., [2, 1, 0]].numpy()


def portrait(settings: Settings, size: int) -> Image.Image:
    """The start of an episode from the ``picture`` camera.

    Args:
        settings: environment; its cameras are ignored.
        size: pixels.
    """
    simulation, _ = build(replace(settings, num_envs=1, cams=()))
    simulation.reset()
    engine = simulation.engine
    return Image.fromarray(Photographer(engine.model, size)(engine.data(0)))


def to_rgb(image: np.ndarray, rendering_depth: str) -> np.ndarray:
    """An agent's image ``(channels, h, w)`` as ``(h, w, 3)``; a depth channel as grey."""
    if rendering_depth == "channel":
        return np.repeat(image[-1:], 3, axis=0).transpose(1, 2, 0)
    return image.transpose(1, 2, 0)


def contact_sheet(settings: Settings, size: int, raw: bool) -> Image.Image:
    """Every view x rendering, at the start and at the goal.

    Args:
        settings: environment; its cameras are ignored.
        size: pixels of a tile.
        raw: show the agent's own ``image_size`` pixels instead of a smooth picture.

    Raises:
        ValueError: ``size`` below 16.
        RuntimeError: the teacher did not reach the goal state.
    """
    if size < 16:
        raise ValueError(f"size: {size} must be at least 16")
    pixels = settings.image_size if raw else size * _OVERSAMPLING
    s = replace(settings, cams=_cameras(settings), image_size=pixels, quality=1 if raw else 2)
    states = list(stages(s, "start", "goal").values())
    return _lay_out(s, states, size, Image.Resampling.NEAREST if raw else Image.Resampling.BOX)


def tiles(settings: Settings, cams: Sequence[str] = ()) -> dict[str, Image.Image]:
    """What an agent sees through each camera, start and goal side by side, by camera.

    Args:
        settings: environment; its cameras are ignored.
        cams: which; by default every rendering of every view.

    Raises:
        RuntimeError: the teacher did not reach the goal state.
    """
    shown = tuple(cams) or _cameras(settings)
    seen = stages(replace(settings, cams=shown), "start", "goal").values()
    depths = {name: settings.renderings[name.partition("_")[0]].depth for name in shown}
    return {
        name: Image.fromarray(np.hstack([to_rgb(images[name], depth) for images in seen]))
        for name, depth in depths.items()
    }


def _cameras(settings: Settings) -> tuple[str, ...]:
    """Every rendering of every view."""
    return tuple(f"{r}_{v}" for r in _ordered(settings) for v in settings.views)


def _ordered(settings: Settings) -> list[str]:
    """Renderings from plain to derived: lit colours, then flat; depth after none."""
    kinds = settings.renderings
    return sorted(
        kinds, key=lambda name: (kinds[name].colour == "flat", kinds[name].depth != "none")
    )


def stages(settings: Settings, *wanted: str) -> dict[str, dict[str, np.ndarray]]:
    """The images of all cameras at moments of one episode of the task's teacher.

    Args:
        settings: environment and cameras.
        wanted: of ``start``; names of facts, the first step at which that is true; ``goal``, a
            few steps after the task is done.

    Raises:
        RuntimeError: the teacher did not get that far.
    """
    # The episode must go on after success.
    s = replace(settings, num_envs=1, episode=replace(settings.episode, end_on_success=False))
    simulation, imager = build(s)
    seen: dict[str, dict[str, np.ndarray]] = {}
    since = 0
    for step in rollout(simulation, controller(s.definition.teacher, s), imager):
        since += bool(since or step.moment.facts[s.definition.goal][0])
        for name in _reached(step, since > _AFTER_SUCCESS):
            if name in wanted and name not in seen:
                seen[name] = {camera: image[0].numpy() for camera, image in step.images().items()}
        if set(wanted) <= set(seen):
            return seen
    missing = ", ".join(name for name in wanted if name not in seen)
    raise RuntimeError(f"the teacher did not get to {missing} with seed={settings.seed}")


def _reached(step: Step, goal: bool) -> list[str]:
    """Stages that the one environment is at: ``start``, facts that are true, ``goal``."""
    facts = [name for name, fact in step.moment.facts.items() if bool(fact[0])]
    return [*(["start"] if step.action is None else []), *facts, *(["goal"] if goal else [])]


def _lay_out(
    settings: Settings,
    states: Sequence[dict[str, np.ndarray]],
    size: int,
    resampling: Image.Resampling,
) -> Image.Image:
    views, renderings = list(settings.views), _ordered(settings)
    gap, margin = max(2, size // 64), size // 6
    font = ImageFont.load_default(max(9, size // 12))
    block = len(views) * (size + gap) + margin // 2
    sheet = Image.new(
        "RGB",
        (margin + len(states) * block, 2 * margin + len(renderings) * (size + gap)),
        _PAPER,
    )
    draw = ImageDraw.Draw(sheet)
    for row, rendering in enumerate(renderings):
        y = 2 * margin + row * (size + gap)
        label = Image.new("RGB", (size, margin), _PAPER)
        centre = (size // 2, margin // 2)
        ImageDraw.Draw(label).text(centre, rendering, _INK, font=font, anchor="mm")
        sheet.paste(label.rotate(90, expand=True), (0, y))
        for column, images in enumerate(states):
            for place, view in enumerate(views):
                x = margin + column * block + place * (size + gap)
                tile = to_rgb(images[f"{rendering}_{view}"], settings.renderings[rendering].depth)
                picture = Image.fromarray(np.ascontiguousarray(tile))
                sheet.paste(picture.resize((size, size), resampling), (x, y))
    for column, title in enumerate(("start", "goal")):
        x = margin + column * block
        middle = x + (block - margin // 2) // 2
        draw.text((middle, margin // 2), title, _INK, font=font, anchor="mm")
        for place, view in enumerate(views):
            at = (x + place * (size + gap) + size // 2, 3 * margin // 2)
            draw.text(at, view, _INK, font=font, anchor="mm")
    return sheet
