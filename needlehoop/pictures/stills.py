"""Pictures of the scene: a portrait, and sheets of every camera and every disturbance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice

import mujoco
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from needlehoop.config import strict
from needlehoop.config.strict import Pixels
from needlehoop.disturbances.axes import AXES, Levels, disturb_of, ladder
from needlehoop.engines.contract import FIELDS, Channels
from needlehoop.envs.build import PICTURE, build
from needlehoop.envs.controllers import controller, rollout
from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import Rendering, in_rows
from needlehoop.scene.image_size import scaled_to, sides

_OVERSAMPLING = 3
_AFTER_SUCCESS = 4
"""Steps from success to the goal picture, which then shows the goal clearly."""

_STEPS = 10
"""Steps of the expert before disturbances are shown: late and frozen pictures show then."""

_SEVERITIES = (0, 1, 3, 5)
"""Those shown; 0: undisturbed."""

_INK, _PAPER = (34, 38, 46), (255, 255, 255)


class Photographer:
    """Takes pictures of one MjData from the ``picture`` camera, ``size`` (1 to 4096) px wide."""

    def __init__(self, model: mujoco.MjModel, size: int):
        strict.structure(size, Pixels, "size")
        # Imported where it is used: mujoco_warp takes two seconds.
        from needlehoop.engines.tracer import Tracer

        self._tracer = Tracer(model, 1, {PICTURE: Channels(True, False, False)}, size, 2)

    def __call__(self, data: mujoco.MjData) -> np.ndarray:
        """The scene as RGB ``(size, size, 3)`` uint8."""
        fields = {name: torch.tensor(getattr(data, name)[None]) for name in FIELDS}
        frame = self._tracer.render(fields)[PICTURE]
        assert frame.bgra is not None
        return frame.bgra[0, ..., [2, 1, 0]].numpy()


def portrait(settings: Settings, size: int) -> Image.Image:
    """The start of an episode from the ``picture`` camera, ``size`` px wide; for notebooks."""
    simulation = build(replace(settings, num_envs=1, cams=()))
    simulation.reset()
    engine = simulation.engine
    return Image.fromarray(Photographer(engine.model, size)(engine.data(0)))


def to_rgb(image: np.ndarray, rendering_depth: str) -> np.ndarray:
    """An agent's image ``(channels, h, w)`` as ``(h, w, 3)``; a depth channel as grey."""
    if rendering_depth == "channel":
        image = np.repeat(image[-1:], 3, axis=0)
    return np.ascontiguousarray(image.transpose(1, 2, 0))


def scaled(image: np.ndarray, rendering: Rendering, size: int, raw: bool = True) -> Image.Image:
    """An agent's image as a picture whose longer side is ``size`` px; ``raw``: enlarged without
    smoothing.
    """
    resampling = Image.Resampling.NEAREST if raw else Image.Resampling.BOX
    whole = sides(scaled_to((image.shape[2], image.shape[1]), size))
    return Image.fromarray(to_rgb(image, rendering.depth)).resize(whole, resampling)


def contact_sheet(settings: Settings, size: int, raw: bool) -> Image.Image:
    """Every view x rendering, at the start and at the goal, in tiles of ``size`` px.

    ``raw`` shows the agent's own ``image_size`` pixels instead of a smooth picture. Errors are as
    in ``stages``.
    """
    agent_size = settings.image_size
    pixels = agent_size if raw else scaled_to(agent_size, size * _OVERSAMPLING)
    s = replace(settings, cams=_cameras(settings), image_size=pixels, quality=1 if raw else 2)
    states = list(stages(s, "start", "goal").values())
    renderings = _ordered(s)
    # The eyes of a stereo camera are beside each other.
    rows = in_rows([camera for camera in s.cameras if camera.rendering == renderings[0]], s.views)
    views = [camera.view for row in rows for camera in row]

    def tile(row: int, block: int, column: int) -> Image.Image:
        image = states[block][f"{renderings[row]}_{views[column]}"]
        return scaled(image, s.renderings[renderings[row]], size, raw)

    return sheet(renderings, ("start", "goal"), views, size, tile)


def tiles(settings: Settings, cams: Sequence[str] = ()) -> dict[str, Image.Image]:
    """What an agent sees through each camera, start and goal side by side, by camera.

    By default through every rendering of every view; the settings' own cameras are ignored. Errors
    are as in ``stages``.
    """
    shown = tuple(cams) or _cameras(settings)
    seen = stages(replace(settings, cams=shown), "start", "goal").values()
    depths = {name: settings.renderings[name.partition("_")[0]].depth for name in shown}
    return {
        name: Image.fromarray(np.hstack([to_rgb(images[name], depth) for images in seen]))
        for name, depth in depths.items()
    }


def _cameras(settings: Settings) -> tuple[str, ...]:
    return tuple(f"{r}_{v}" for r in _ordered(settings) for v in settings.views)


def _ordered(settings: Settings) -> list[str]:
    """Renderings from plain to derived: lit colours, then flat; depth after none."""
    kinds = settings.renderings
    return sorted(
        kinds, key=lambda name: (kinds[name].colour == "flat", kinds[name].depth != "none")
    )


def stages(settings: Settings, *moments: str) -> dict[str, dict[str, np.ndarray]]:
    """The images of all cameras at moments of one episode of the task's teacher.

    ``moments``: ``start``; ``goal``, a few steps after the task is done; or a fact's name, for the
    first step at which it is true. ``RuntimeError``: the teacher did not get that far.
    """
    # The episode must go on after success.
    s = replace(settings, num_envs=1, episode=replace(settings.episode, end_on_success=False))
    simulation = build(s)
    seen: dict[str, dict[str, np.ndarray]] = {}
    since = 0
    for step in rollout(simulation, controller(s.definition.teacher, s)):
        facts = {name: bool(fact[0]) for name, fact in step.moment.facts.items()}
        since += bool(since or facts[s.definition.goal])
        here = {"start": step.action is None, **facts, "goal": since > _AFTER_SUCCESS}
        for name in moments:
            if name not in seen and here.get(name):
                images = simulation.images()
                seen[name] = {camera: image[0].cpu().numpy() for camera, image in images.items()}
        if set(moments) <= set(seen):
            return seen
    missing = ", ".join(name for name in moments if name not in seen)
    raise RuntimeError(f"the teacher did not get to {missing} with seed={settings.seed}")


def disturbed_sheet(settings: Settings, levels: Levels, tile: int) -> Image.Image:
    """A row for each axis that can be seen; undisturbed, then severities 1, 3 and 5 by camera.

    Each tile, ``tile`` px wide, is what one episode drew: a uniform share of the severity's amount
    in ``levels``. The episode is the same everywhere. The settings' own disturbances are ignored.
    """
    if not settings.cams:
        raise ValueError("cams: choose the cameras to show, such as cams=rgb_front,dep_front")
    axes = [key for key in AXES if not key.startswith("robot.")]
    rows = ladder(levels, max(_SEVERITIES))
    cases = [(key, severity) for key in axes for severity in _SEVERITIES]
    batch = replace(
        settings,
        num_envs=len(cases),
        disturb=disturb_of({key: rows[key][max(_SEVERITIES)] for key in axes}),
        episode=replace(settings.episode, end_on_success=False),
    )
    simulation = build(batch)
    amounts = {
        key: torch.tensor([rows[key][s] if k == key else 0.0 for k, s in cases]) for key in axes
    }
    first = torch.zeros(len(cases), dtype=torch.int64)
    simulation.deal(torch.arange(len(cases)), first, amounts)
    flight = rollout(simulation, controller(batch.definition.teacher, batch))
    # Every step is looked at: cameras that deliver late give what they saw before.
    *_, images = (simulation.images() for _ in islice(flight, _STEPS + 1))

    def picture(row: int, block: int, column: int) -> Image.Image:
        camera = batch.cameras[block]
        image = images[camera.name][row * len(_SEVERITIES) + column].cpu().numpy()
        return scaled(image, batch.renderings[camera.rendering], tile)

    titles = [f"severity {severity}" if severity else "undisturbed" for severity in _SEVERITIES]
    return sheet(axes, batch.cams, titles, tile, picture)


def sheet(
    rows: Sequence[str],
    blocks: Sequence[str],
    columns: Sequence[str],
    size: int,
    tile: Callable[[int, int, int], Image.Image],
) -> Image.Image:
    """Tiles in rows and in blocks of columns, with the names of all.

    ``tile`` makes the picture in a row, a block and a column, by their numbers, at most ``size``
    px wide and high.
    """
    gap, head, font = max(2, size // 32), size // 6, ImageFont.load_default(max(9, size // 12))
    label = round(max(map(font.getlength, rows))) + 4 * gap
    pace = len(columns) * (size + gap) + head // 2
    whole = (label + len(blocks) * pace, 2 * head + len(rows) * (size + gap))
    made = Image.new("RGB", whole, _PAPER)
    draw = ImageDraw.Draw(made)
    write = partial(draw.text, fill=_INK, font=font)
    for row, name in enumerate(rows):
        write((label - 2 * gap, 2 * head + row * (size + gap) + size // 2), name, anchor="rm")
    for block, name in enumerate(blocks):
        left = label + block * pace
        write((left + (pace - head // 2) // 2, head // 2), name, anchor="mm")
        for column, title in enumerate(columns):
            x = left + column * (size + gap)
            write((x + size // 2, 3 * head // 2), title, anchor="mm")
            for row in range(len(rows)):
                made.paste(tile(row, block, column), (x, 2 * head + row * (size + gap)))
    return made
