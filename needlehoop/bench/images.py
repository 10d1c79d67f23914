"""What an image costs, by renderer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from needlehoop.engines.contract import RENDERERS, EngineConfig
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings

_ENVS = 16
"""Environments of a timing: few, so that the tracer's turns don't take all day."""


def core_time(settings: Settings, rounds: int) -> dict[str, dict[str, float]]:
    """Processor time per image in ms, by rendering and renderer: the least of ``rounds``.

    Over all views, at the start of an episode, one thread; composing the channels excluded.
    The renderers take turns, and time that other processes take is not counted.
    """
    found = {}
    for rendering in settings.renderings:
        jobs = {kind: _job(settings, rendering, kind) for kind in RENDERERS}
        times = dict.fromkeys(RENDERERS, float("inf"))
        for _ in range(rounds):
            for kind, (count, render) in jobs.items():
                began = time.thread_time()
                render()
                times[kind] = min(times[kind], 1e3 * (time.thread_time() - began) / count)
        found[rendering] = {kind: round(took, 4) for kind, took in times.items()}
    return found


def _job(settings: Settings, rendering: str, kind: str) -> tuple[int, Callable[[], object]]:
    """Images of a call, and the call."""
    cams = tuple(f"{rendering}_{view}" for view in settings.views)
    chosen = replace(settings, cams=cams, num_envs=_ENVS, engine=EngineConfig(1, kind))
    simulation, _ = build(chosen)
    simulation.reset()
    return _ENVS * len(cams), simulation.engine.render
