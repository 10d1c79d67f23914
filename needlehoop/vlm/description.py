"""The scene, its cameras and the language of rewards in words, from what defines them.

Nothing of the rewards that people wrote, and none of the limits by which the task decides
what has been reached, is said here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import Rendering, View
from needlehoop.vlm.prompts import fill

_CONTROLS = {
    "tip": "moves the tip of the instrument along x, y and z, turns it about its own axis, and"
    " opens or closes the jaws",
    "pose": "moves the tip of the instrument along x, y and z, turns it about any axis, and"
    " opens or closes the jaws",
}


def scene(settings: Settings) -> str:
    """What stands where, what is to be done, and what an agent can do."""
    task = settings.task
    x, y, z = task.hoop_position
    away = math.dist((x, y), task.needle_position)
    return fill(
        "scene",
        needle_radius=_millimetres(task.needle_radius),
        needle_arc=round(math.degrees(task.needle_arc)),
        needle_thickness=_millimetres(task.needle_thickness),
        hoop_opening=_millimetres(task.hoop_opening),
        hoop_height=round(1000 * z),
        hoop_away=round(1000 * away),
        control=_CONTROLS[settings.episode.control],
    )


def cameras(settings: Settings, renderings: Sequence[str]) -> str:
    """All views, some renderings, and how cameras are named."""
    views = settings.views
    return fill(
        "cameras",
        views=bullets({name: view(views[name]) for name in views}),
        renderings=bullets({name: rendering(settings.renderings[name]) for name in renderings}),
        example=f"{renderings[0]}_{next(iter(views))}",
    )


def view(view: View) -> str:
    """Where a camera stands."""
    turn = view.azimuth
    if turn % 360 == 0:
        where = "in front of the hoop"
    else:
        side = "left" if turn > 0 else "right"
        where = f"turned {abs(turn):g} degrees from the hoop's front towards its {side}"
    return f"{where}, looking down at {view.elevation:g} degrees"


def rendering(rendering: Rendering) -> str:
    """What a camera reports, and how its picture is shown to the model."""
    classes = ", ".join(f"{name} {tuple(rgb)}" for name, rgb in rendering.colours.items())
    colours = {
        "rgb": "colours as an ordinary camera sees them",
        "flat": f"a strong flat colour for each important thing (RGB: {classes}), all else black",
        "none": "",
    }[rendering.colour]
    grey = "depth in shades of grey, brighter where nearer"
    if rendering.depth == "shade":
        return f"{colours}, darker with distance"
    if rendering.depth == "none":
        return colours
    if not colours:
        return grey
    return f"{grey} (the agent is given {colours}, as well)"


def language(functions: Mapping[str, tuple[str, str]], result: str) -> str:
    """The rules of reward programs.

    Args:
        functions: signature and meaning by name.
        result: one sentence on how a program gives its value.
    """
    lines = "\n".join(f"- {signature}: {meaning}" for signature, meaning in functions.values())
    return fill("language", functions=lines, result=result)


def bullets(entries: Mapping[str, str]) -> str:
    """One line for each entry: its name, then what it is."""
    return "\n".join(f"- {name}: {text}" for name, text in entries.items())


def _millimetres(metres: float) -> str:
    return f"{1000 * metres:.1f}".removesuffix(".0")
