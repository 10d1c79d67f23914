"""Episodes in a window, in real time, with somebody acting."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from itertools import count

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.rollout import Controller
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.pictures.window import Window, check_display

_INSTEAD = "`needlehoop expert --video out.mp4` writes a video"


def view(settings: Settings, who: str) -> None:
    """Open a window and run episodes in real time until it is closed.

    Raises:
        RuntimeError: this machine has no display.
        ValueError: an unknown controller.
    """
    check_display(_INSTEAD)
    alone = replace(settings, num_envs=1, cams=())
    simulation, _ = build(alone)
    play(Window(simulation, alone, _INSTEAD), alone, simulation, controller(who, alone), count())


def play(
    window: Window,
    settings: Settings,
    simulation: Simulation,
    act: Controller,
    episodes: Iterable[int],
) -> None:
    """Run episodes in real time in a window until they are over or it is closed.

    Args:
        window: on the simulation; closed at the end.
        settings: of the simulation.
        simulation: of one environment.
        act: who acts.
        episodes: as many as there are numbers.
    """
    try:
        for _ in episodes:
            moment, over = simulation.reset(), False
            while not over:
                window.show()
                if window.is_closed:
                    return
                began = time.monotonic()
                moment = simulation.step(act(moment.signals))
                over = bool(moment.terminated[0] | moment.truncated[0])
                time.sleep(max(0.0, settings.period - (time.monotonic() - began)))
            window.show()
    finally:
        window.close()
