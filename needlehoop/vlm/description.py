"""The scene, its cameras, its signals and the language of rewards, in words for a model.

The texts of ``prompts/`` are general. A task's own words and texts are put into them, and numbers
from the settings. A model is told nothing of the human reward, and no limit that decides success.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

import numpy as np
from tabulate import tabulate

from needlehoop.envs.images import DARKEST
from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.functions import FUNCTIONS
from needlehoop.rewards.language.program import MAX_EXPONENT
from needlehoop.scene.cameras import Rendering, View, line_of_sight, pose_of
from needlehoop.scene.image_size import ImageSize, extent, sides
from needlehoop.scene.signals import describe, vocabulary
from needlehoop.tasks.contract import Task, Telling
from needlehoop.vlm.moments import ranges

_GENERAL = Path(__file__).parent / "prompts"
_INTO = {"scene", "signals"}
"""Texts of a task that general ones take in."""


def telling_of(task: Task) -> Telling:
    """A task's words; ``ValueError`` if it has none."""
    if task.telling is None:
        raise ValueError(f"task {task.name}: no model can be asked about it; it has no telling")
    return task.telling


def fill(name: str, task: Task | None = None, /, **values: object) -> str:
    """The prompt ``<name>.txt``, general or a task's own, with its ``$gaps`` filled."""
    prompts = _read(_GENERAL) if task is None else texts(task)
    return Template(prompts[name]).substitute(values).strip()


def texts(task: Task) -> dict[str, str]:
    """All prompts for a task by name, with ``$gaps``: the general ones, and its own.

    ``ValueError``: a text of the task is missing, or belongs to no moment.
    """
    telling = telling_of(task)
    task_texts = _read(telling.texts)
    if odd := sorted((_INTO - {*task_texts}) | ({*task_texts} - _INTO - {*telling.moments})):
        raise ValueError(f"{telling.texts}: {odd[0]}.txt is missing or not asked for")
    words = {f"task_{name}": task_texts.pop(name).strip() for name in _INTO}
    words |= {"goal": telling.goal, "done": telling.done}
    general = _read(_GENERAL).items()
    return {name: Template(text).safe_substitute(words) for name, text in general} | task_texts


def _read(folder: Path) -> dict[str, str]:
    return {file.stem: file.read_text(encoding="utf-8") for file in folder.glob("*.txt")}


def questioned(task: Task) -> dict[str, str]:
    """What is true at each moment that has a question of its own: what shows it best."""
    prompts = texts(task)
    return {fact: so for fact, so in telling_of(task).moments.items() if fact in prompts}


def stages_of(task: Task) -> dict[str, str]:
    """The stages of an episode that are pictured, in order, and what is true in each."""
    telling = telling_of(task)
    return {"start": "an episode begins", **telling.moments, "goal": telling.goal}


def scene(settings: Settings, prompt_detail: str = "full") -> str:
    """What stands where, what the task is, and what an agent can do.

    ``prompt_detail``: with ``names`` the signals' names and ranges stand in its place.
    """
    if prompt_detail == "full":
        period = f"{1000 * settings.period:g}"
        return fill("scene", settings.definition, **_task_values(settings), milliseconds=period)
    nothing = fill("told_nothing")
    if prompt_detail == "names":
        return fill("told_names", nothing=nothing, ranges=unexplained(settings))
    return nothing


def stages(settings: Settings, prompt_detail: str = "full") -> str:
    """The stages that pictures show, by the names that the pictures give them."""
    meanings = stages_of(settings.definition)
    if prompt_detail != "full":
        phrases = ["an episode begins", *["on the way"] * (len(meanings) - 2), "the task is done"]
        meanings = dict(zip(stage_names(settings, prompt_detail), phrases, strict=True))
    return fill("stages", stages=bullets(meanings))


def stage_names(settings: Settings, prompt_detail: str = "full") -> list[str]:
    """Names of the stages in their order: they say nothing of the task unless all is told."""
    names = [*stages_of(settings.definition)]
    return names if prompt_detail == "full" else [f"stage {n}" for n in range(1, len(names) + 1)]


def unexplained(settings: Settings) -> str:
    """The signals that a program may read, without their meaning: shapes, units and ranges."""
    reached = ranges(settings)
    rows = [("name", "shape", "unit", "frame", "least", "most")]
    for name, row in vocabulary(settings.definition.signals).items():
        shape = "x".join(map(str, row.shape)) or "scalar"
        least, most = (", ".join(f"{round(v, 3) + 0.0:.3f}" for v in end) for end in reached[name])
        rows.append((name, shape, row.unit, row.frame, least, most))
    return fill("ranges", table=tabulate(rows, tablefmt="plain", disable_numparse=True))


def signals(settings: Settings) -> str:
    """The signals that a program may read: their table and the numbers behind them."""
    table = describe(vocabulary(settings.definition.signals))
    return fill("signals", settings.definition, **_task_values(settings), table=table)


def _task_values(settings: Settings) -> Mapping[str, object]:
    values = telling_of(settings.definition).values(settings.task, settings.episode)
    return {**values, "steps": settings.episode.max_steps}


def cameras(settings: Settings, renderings: Sequence[str]) -> str:
    """All views, the given renderings, and how cameras are named."""
    views, task, size = settings.views, settings.definition, settings.image_size
    kinds, telling = settings.renderings, telling_of(task)
    explained = {name: rendering(kinds[name], telling, views) for name in renderings}
    return fill(
        "cameras",
        views=bullets({name: view(camera, task, size) for name, camera in views.items()}),
        renderings=bullets(explained),
        example=f"{renderings[0]}_{next(iter(views))}",
        pixels=extent(size),
    )


def view(view: View, task: Task, size: ImageSize) -> str:
    """Where a camera stands or is mounted, and how much it sees in images of a size."""
    where, distance = (
        _mount(view, view.body, task) if view.body else _stand(view, telling_of(task).front)
    )
    width, height = sides(size)
    wide = 2000 * distance * math.tan(math.radians(view.fovy / 2)) * (width / height)
    if view.roll:
        where += f", turned by {view.roll:g} degrees about its line of sight"
    far = f"{1000 * distance:.0f} mm from"
    if view.orbit is None:
        return f"{where}; at {far} it its image is {wide:.0f} mm wide"
    middle = "the point in the middle of its image"
    return f"{where}, {far} {middle}, which is {wide:.0f} mm wide there"


def _stand(view: View, front: str) -> tuple[str, float]:
    """Where a camera stands, seen from its azimuth 0, and its distance, m, from what it shows."""
    if view.orbit is not None:
        _, turn, elevation, distance = view.orbit
    else:
        position, quaternion = pose_of(view)
        x, y, z = line_of_sight(quaternion).tolist()
        # To a tenth of a degree. Straight down is as if from the front.
        turn = round(math.degrees(math.atan2(x, y)), 1) if math.hypot(x, y) > 1e-9 else 0.0
        elevation = round(math.degrees(math.asin(-z)), 1)
        distance = float(np.linalg.norm(view.focus - position))
    where = f"in front of {front}"
    if turn % 360:
        side = f"to the {'left' if turn > 0 else 'right'} of one who stands there and faces it"
        where = f"{abs(turn):g} degrees round from the front of {front}, {side}"
    return f"{where}, looking down at {elevation:g} degrees", distance


def _mount(view: View, body: str, task: Task) -> tuple[str, float]:
    """What a camera is mounted on, and its distance, m, from what it shows."""
    part = task.robot.parts.get(body)
    name = f"the moving body {body}" if part is None else part.name
    where = f"mounted on {name}, with which it moves and turns"
    position, quaternion = pose_of(view)
    if part is not None:
        straight = float(np.clip(line_of_sight(quaternion) @ part.along, -1.0, 1.0))
        turned = f"{math.degrees(math.acos(straight)):.0f} degrees turned from that"
        where += f", looking along it towards its tip, {turned}"
    return where, float(np.linalg.norm(view.focus - position))


def rendering(rendering: Rendering, telling: Telling, views: Mapping[str, View]) -> str:
    """What a camera gives the agent, and how its picture is shown to the model."""
    classes = ", ".join(f"{name} {tuple(rgb)}" for name, rgb in rendering.colours.items())
    colours = {
        "rgb": "colours as an ordinary camera sees them",
        "flat": f"one flat colour for each kind of thing (RGB: {classes}), all else black",
        "none": "",
    }[rendering.colour]
    remarks = (remark for name, remark in telling.painted.items() if name in rendering.colours)
    colours = "; ".join((colours, *remarks))
    if rendering.depth == "none":
        return colours
    near, far = _lengths(views, "near"), _lengths(views, "far")
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


def _lengths(views: Mapping[str, View], end: str) -> str:
    """The ``near`` or ``far`` end of each view's depths, in words; one where all are the same."""
    lengths = {name: f"{1000 * getattr(view, end):g} mm" for name, view in views.items()}
    if len({*lengths.values()}) == 1:
        return next(iter(lengths.values()))
    return ", ".join(f"{length} ({name})" for name, length in lengths.items())


def language() -> str:
    lines = bullets({row.signature: row.meaning for row in FUNCTIONS.values()})
    return fill("language", functions=lines, exponent=MAX_EXPONENT)


def bullets(entries: Mapping[str, str]) -> str:
    return "\n".join(f"- {name}: {text}" for name, text in entries.items())
