"""The scene, its cameras, its signals and the language of rewards, in words for a model.

Numbers come from the settings. A model is told nothing of the human reward, and none of the
limits by which the task decides on success.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from needlehoop.envs.images import DARKEST
from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.compiler import MAX_EXPONENT
from needlehoop.rewards.language.functions import FUNCTIONS
from needlehoop.scene.cameras import Rendering, View
from needlehoop.scene.signals import describe, vocabulary
from needlehoop.tasks.contract import Telling
from needlehoop.vlm.moments import ranges
from needlehoop.vlm.prompts import fill, fill_told, stages_of, telling_of

_RESULT = (
    "The program's value is what it last assigns to the variable reward. Assigned names may not be"
    " those of signals or functions."
)


def scene(settings: Settings, told: str = "full") -> str:
    """What stands where, what the task is, and what an agent can do.

    Args:
        settings: the scene.
        told: ``full``; ``names``: the signals' names and ranges in its place; or ``nothing``.
    """
    if told == "full":
        return fill_told(
            "scene",
            settings.definition,
            _told(settings),
            steps=settings.episode.max_steps,
            milliseconds=f"{1000 * settings.period:g}",
        )
    nothing = fill("told_nothing")
    if told == "nothing":
        return nothing
    return fill("told_names", nothing=nothing, ranges=unexplained(settings))


def stages(settings: Settings, told: str = "full") -> str:
    """The stages that pictures show, by the names that the pictures give them."""
    own = stages_of(settings.definition)
    if told != "full":
        said = [*own.values()]
        said[-1], said[1:-1] = "the task is done", ["on the way"] * (len(own) - 2)
        own = dict(zip(stage_names(settings, told), said, strict=True))
    return fill("stages", stages=bullets(own))


def stage_names(settings: Settings, told: str = "full") -> list[str]:
    """Names of the stages in their order: they say nothing of the task unless all is told."""
    own = stages_of(settings.definition)
    return [*own] if told == "full" else [f"stage {number}" for number, _ in enumerate(own, 1)]


def unexplained(settings: Settings) -> str:
    """The signals that a program may read, without their meaning: shapes, units and ranges."""
    reached = ranges(settings)
    rows = [("name", "shape", "unit", "frame", "least", "most")]
    for name, row in vocabulary(settings.definition.signals).items():
        shape = "x".join(map(str, row.shape)) or "scalar"
        least, most = (", ".join(f"{round(v, 3) + 0.0:.3f}" for v in end) for end in reached[name])
        rows.append((name, shape, row.unit, row.frame, least, most))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    return fill("ranges", table="\n".join(lines))


def signals(settings: Settings) -> str:
    """The signals that a program may read: their table and the numbers behind them."""
    return fill_told(
        "signals",
        settings.definition,
        _told(settings),
        table=describe(vocabulary(settings.definition.signals)),
        steps=settings.episode.max_steps,
    )


def _told(settings: Settings) -> Mapping[str, object]:
    return telling_of(settings.definition).values(settings.task, settings.episode)


def cameras(settings: Settings, renderings: Sequence[str]) -> str:
    """All views, the given renderings, and how cameras are named."""
    views, telling = settings.views, telling_of(settings.definition)
    told = {name: rendering(settings.renderings[name], telling, views) for name in renderings}
    return fill(
        "cameras",
        views=bullets({name: view(views[name], telling) for name in views}),
        renderings=bullets(told),
        example=f"{renderings[0]}_{next(iter(views))}",
        pixels=settings.image_size,
    )


def view(view: View, telling: Telling) -> str:
    """Where a camera stands, and how much it sees."""
    turn = view.azimuth
    where = f"in front of {telling.front}"
    if turn % 360:
        side = "left" if turn > 0 else "right"
        where = (
            f"{abs(turn):g} degrees round from the front of {telling.front}, to the {side} of one"
            " who stands there and faces it"
        )
    wide = 2000 * view.distance * math.tan(math.radians(view.fovy / 2))
    return (
        f"{where}, looking down at {view.elevation:g} degrees, {1000 * view.distance:.0f} mm from"
        f" the point in the middle of its image, which is {wide:.0f} mm wide there"
    )


def rendering(rendering: Rendering, telling: Telling, views: Mapping[str, View]) -> str:
    """What a camera gives the agent, and how its picture is shown to the model."""
    classes = ", ".join(f"{name} {tuple(rgb)}" for name, rgb in rendering.colours.items())
    colours = {
        "rgb": "colours as an ordinary camera sees them",
        "flat": f"one flat colour for each kind of thing (RGB: {classes}), all else black",
        "none": "",
    }[rendering.colour]
    for name, remark in telling.painted.items():
        if name in rendering.colours:
            colours += f"; {remark}"
    if rendering.depth == "none":
        return colours
    near, far = _depths(views)
    if rendering.depth == "shade":
        return (
            f"{colours}; the colours darken evenly with the distance along the line of sight, from"
            f" full brightness at {near} to {100 * DARKEST:g} % of it at {far}"
        )
    grey = (
        "depth as shades of grey: the distance along the line of sight, evenly from 255 (white) at"
        f" {near} or less to 0 (black) at {far} or more"
    )
    if not colours:
        return grey
    return (
        f"{colours}, and from the same camera {grey}; the agent is given both, and the pictures"
        " show both, the colours on the left and the depth on the right"
    )


def _depths(views: Mapping[str, View]) -> tuple[str, str]:
    """The distances at which greys begin and end, in words."""

    def said(ends: Mapping[str, float]) -> str:
        lengths = {name: f"{1000 * end:g} mm" for name, end in ends.items()}
        if len(set(lengths.values())) == 1:
            return next(iter(lengths.values()))
        return ", ".join(f"{length} ({name})" for name, length in lengths.items())

    near = {name: view.near for name, view in views.items()}
    return said(near), said({name: view.far for name, view in views.items()})


def language() -> str:
    """The rules of reward programs."""
    lines = "\n".join(f"- {row.signature}: {row.meaning}" for row in FUNCTIONS.values())
    return fill("language", functions=lines, result=_RESULT, exponent=MAX_EXPONENT)


def bullets(entries: Mapping[str, str]) -> str:
    """One line for each entry: its name, then its text."""
    return "\n".join(f"- {name}: {text}" for name, text in entries.items())
