"""The scene, its cameras, its signals and the language of rewards, in words for a model.

Numbers come from the settings. A model is told nothing of the human reward, and none of the
limits by which the task decides on success.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.expressions import MAX_EXPONENT
from needlehoop.scene.cameras import Rendering, View
from needlehoop.scene.signals import describe, vocabulary
from needlehoop.tasks.contract import Telling
from needlehoop.vlm.prompts import fill, fill_told, telling_of


def scene(settings: Settings) -> str:
    """What stands where, what the task is, and what an agent can do."""
    return fill_told(
        "scene",
        settings.definition,
        _told(settings),
        steps=settings.episode.max_steps,
        milliseconds=f"{1000 * settings.period:g}",
    )


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
    told = {name: rendering(settings.renderings[name], telling) for name in renderings}
    return fill(
        "cameras",
        views=bullets({name: view(views[name], telling) for name in views}),
        renderings=bullets(told),
        example=f"{renderings[0]}_{next(iter(views))}",
        pixels=settings.image_size,
    )


def view(view: View, telling: Telling) -> str:
    """Where a camera stands."""
    turn = view.azimuth
    if turn % 360 == 0:
        where = f"in front of {telling.front}"
    else:
        side = "left" if turn > 0 else "right"
        where = f"turned {abs(turn):g} degrees from {telling.front}'s front towards its {side}"
    return f"{where}, looking down at {view.elevation:g} degrees"


def rendering(rendering: Rendering, telling: Telling) -> str:
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
