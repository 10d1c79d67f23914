"""Controllers by name, for commands that let somebody act."""

from __future__ import annotations

from needlehoop.envs.rollout import Controller, random_controller
from needlehoop.envs.settings import Settings
from needlehoop.task.expert import cheat, expert
from needlehoop.task.smooth import smooth

_SCRIPTS = {"expert": expert, "smooth": smooth, "cheat": cheat}

CONTROLLERS = (*_SCRIPTS, "random")


def controller(name: str, settings: Settings) -> Controller:
    """A controller for an environment's settings.

    Raises:
        ValueError: an unknown name, or a script for another control mode.
    """
    if name == "random":
        return random_controller(settings.episode.action_size, settings.seed)
    if name not in CONTROLLERS:
        raise ValueError(f"controller: {name!r} is unknown; choose from {', '.join(CONTROLLERS)}")
    return _SCRIPTS[name](settings.task, settings.episode)
