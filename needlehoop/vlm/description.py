"""The scene, its cameras, its signals and the language of rewards, in words for a model.

Numbers come from the settings. A model is told nothing of the human reward, and none of the
limits by which the task decides on success.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.expressions import MAX_EXPONENT
from needlehoop.scene.cameras import Rendering, View
from needlehoop.scene.signals import describe, vocabulary
from needlehoop.tasks.needle_hoop.layout import NeedleLayout
from needlehoop.vlm.prompts import fill

_CONTROLS = {
    "tip": "moves the tip of the instrument by up to {move} mm along each of x, y and z, turns it"
    " by up to {turn} rad about its own axis, and opens or closes the jaws by up to {jaw} rad",
    "pose": "moves the tip of the instrument by up to {move} mm along each of x, y and z, turns it"
    " by up to {turn} rad about each of them, and opens or closes the jaws by up to {jaw} rad",
}

_GRASPED = {
    "weld": "becomes true when both jaws touch the needle while jaw_command is below {close} rad;"
    " it stays so, without flicker, until jaw_command rises above {release} rad.",
    "friction": "becomes true when the needle is between the jaws and both touch it while"
    " jaw_command is below {close} rad; it becomes false when neither touches it any more, or when"
    " jaw_command rises above {release} rad, and may flicker.",
}


def scene(settings: Settings) -> str:
    """What stands where, what the task is, and what an agent can do."""
    task: Any = settings.task
    episode: Any = settings.episode
    x, y, z = task.hoop_position
    pickup = (*task.needle_position, task.needle_thickness / 2)
    return fill(
        "scene",
        needle_radius=_millimetres(task.needle_radius),
        needle_arc=round(math.degrees(task.needle_arc)),
        needle_thickness=_millimetres(task.needle_thickness),
        sharp="nearer to" if sharp_end_is_nearer(task) else "farther from",
        hoop_opening=_millimetres(task.hoop_opening),
        hoop_height=round(1000 * z),
        hoop_away=round(1000 * math.dist((x, y), task.needle_position)),
        tool_away=round(1000 * math.dist(task.tool_position, pickup)),
        steps=episode.max_steps,
        milliseconds=f"{1000 * episode.substeps * task.timestep:g}",
        control=_CONTROLS[episode.control].format(
            move=_millimetres(episode.translation),
            turn=f"{episode.rotation:g}",
            jaw=f"{episode.jaw:g}",
        ),
    )


def sharp_end_is_nearer(task: NeedleLayout) -> bool:
    """Whether the sharp end of a needle in its nominal place is the end nearer to the hoop."""
    cos, sin = math.cos(task.needle_yaw), math.sin(task.needle_yaw)
    ends = task.centre_line(np.array(task.needle_angles))[:, :2] @ np.array(
        [[cos, sin], [-sin, cos]]
    )
    away = np.linalg.norm(ends + task.needle_position - task.hoop_position[:2], axis=1)
    return bool(away[1] < away[0])


def signals(settings: Settings) -> str:
    """The signals that a program may read: their table and the numbers behind them."""
    task: Any = settings.task
    episode: Any = settings.episode
    return fill(
        "signals",
        table=describe(vocabulary(settings.definition.signals)),
        side="in front of" if task.needle_position[1] < task.hoop_position[1] else "behind",
        pickup=f"{100 * task.needle_pickup:g}",
        jaw_closed=f"{task.jaw_closed:g}",
        jaw_open=f"{task.jaw_open:g}",
        jaw_start=f"{task.tool_jaw:g}",
        grasped=_GRASPED[episode.grasp].format(
            close=f"{episode.close_below:g}", release=f"{episode.release_above:g}"
        ),
        lift_radius=_millimetres(episode.lift_radius),
        steps=episode.max_steps,
    )


def cameras(settings: Settings, renderings: Sequence[str]) -> str:
    """All views, the given renderings, and how cameras are named."""
    views = settings.views
    return fill(
        "cameras",
        views=bullets({name: view(views[name]) for name in views}),
        renderings=bullets({name: rendering(settings.renderings[name]) for name in renderings}),
        example=f"{renderings[0]}_{next(iter(views))}",
        pixels=settings.image_size,
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
    """What a camera gives the agent, and how its picture is shown to the model."""
    classes = ", ".join(f"{name} {tuple(rgb)}" for name, rgb in rendering.colours.items())
    colours = {
        "rgb": "colours as an ordinary camera sees them",
        "flat": f"one flat colour for each kind of thing (RGB: {classes}), all else black",
        "none": "",
    }[rendering.colour]
    if "hoop" in rendering.colours:
        colours += "; the rod under the ring counts as hoop, the rest of its stand as all else"
    grey = "depth as shades of grey, brighter where nearer"
    if rendering.depth == "shade":
        return f"{colours}; darker with distance"
    if rendering.depth == "none":
        return colours
    if not colours:
        return grey
    return (
        f"{colours}, and from the same camera {grey}; the agent is given both, and the pictures"
        " show both, the colours on the left and the depth on the right"
    )


def language(functions: Mapping[str, tuple[str, str]], result: str) -> str:
    """The rules of reward programs.

    Args:
        functions: signature and meaning by name.
        result: one sentence on how a program gives its value.
    """
    lines = "\n".join(f"- {signature}: {meaning}" for signature, meaning in functions.values())
    return fill("language", functions=lines, result=result, exponent=MAX_EXPONENT)


def bullets(entries: Mapping[str, str]) -> str:
    """One line for each entry: its name, then its text."""
    return "\n".join(f"- {name}: {text}" for name, text in entries.items())


def _millimetres(metres: float) -> str:
    return f"{1000 * metres:.1f}".removesuffix(".0")
