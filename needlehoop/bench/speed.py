"""Speed of the environment, where the time goes, and the same scene elsewhere."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import torch

from needlehoop.bench.images import core_time
from needlehoop.bench.waiting import rounds_of
from needlehoop.engines.contract import RENDERERS
from needlehoop.envs.build import build
from needlehoop.envs.rollout import random_controller
from needlehoop.envs.settings import Settings
from needlehoop.envs.torchrl_env import NeedleHoopEnv
from needlehoop.runs.machine import machine

_DM_STEPS = 40
"""Steps of the single dm_control environment per round."""

_NO_OPENGL = (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError)
"""What a machine without OpenGL raises, by backend; the rest can be measured there."""


def measure(settings: Settings, rounds: int, steps: int) -> dict[str, object]:
    """Environment steps per second, best of ``rounds`` rounds, all in one process.

    Every variant is timed once per round, so what else the machine does hits all alike.

    Args:
        settings: environment with its cameras.
        rounds: how often each variant is timed.
        steps: vector steps per timing.

    Raises:
        ValueError: ``rounds`` or ``steps`` below 1, or no cameras.
    """
    for key, value in (("rounds", rounds), ("steps", steps)):
        if value < 1:
            raise ValueError(f"{key}: {value} must be at least 1")
    if not settings.cams:
        raise ValueError("cams: the benchmark needs at least one camera")
    jobs = _jobs(settings, steps)
    reason = _add_default_renderer(jobs, settings)
    rates = dict.fromkeys(jobs, 0.0)
    for _ in rounds_of(rounds, "round"):
        for name, (count, job) in jobs.items():
            began = time.perf_counter()
            job()
            rates[name] = max(rates[name], count / (time.perf_counter() - began))
    return {**_report(settings, rates, reason), "core_ms_per_image": core_time(settings, rounds)}


def _jobs(settings: Settings, steps: int) -> dict[str, tuple[int, Callable[[], None]]]:
    n, blind = settings.num_envs, replace(settings, cams=())
    seeing, imager = build(settings)
    act = random_controller(settings.episode.action_size, settings.seed)
    moment = seeing.reset()
    actions = [act(moment.signals) for _ in range(steps)]
    frames = seeing.engine.render()

    def repeat(job: Callable[[torch.Tensor], object]) -> tuple[int, Callable[[], None]]:
        def run() -> None:
            for action in actions:
                job(action)

        return n * steps, run

    def environment(s: Settings) -> tuple[int, Callable[[], None]]:
        env = NeedleHoopEnv(s)
        state = {"td": env.reset()}

        def job(action: torch.Tensor) -> None:
            state["td"]["action"] = action.float()
            _, state["td"] = env.step_and_maybe_reset(state["td"])

        return repeat(job)

    def simulation(s: Settings) -> tuple[int, Callable[[], None]]:
        built, _ = build(s)
        built.reset()

        def job(action: torch.Tensor) -> None:
            over = built.step(action)
            ended = over.terminated | over.truncated
            if bool(ended.any()):
                built.reset(ended)

        return repeat(job)

    other = "serial" if settings.psm == "parallelogram" else "parallelogram"
    engine = settings.engine
    rest = {
        f"torchrl_with_images_{kind}": environment(
            replace(settings, engine=replace(engine, renderer=kind))
        )
        for kind in RENDERERS
        if kind != engine.renderer
    }
    return {
        "torchrl_with_images": environment(settings),
        **rest,
        "torchrl_without_images": environment(blind),
        "without_images": simulation(blind),
        f"without_images_{other}": simulation(replace(blind, psm=other)),
        "part_physics": repeat(lambda action: seeing.engine.step(seeing.act(action))),
        "part_task": repeat(lambda action: seeing.observe()),
        "part_rendering": repeat(lambda action: seeing.engine.render()),
        "part_composing": repeat(lambda action: imager(frames)),
    }


def _add_default_renderer(
    jobs: dict[str, tuple[int, Callable[[], None]]], settings: Settings
) -> str | None:
    """Add dm_control with MuJoCo's default OpenGL renderer; why not, where it can't be."""
    try:
        from needlehoop.pictures import opengl

        environment = opengl.OpenGLEnvironment(settings)
        environment.reset()
    except _NO_OPENGL as error:
        return f"{type(error).__name__}: {error}"
    generator = np.random.default_rng(settings.seed)

    def run() -> None:
        for _ in range(_DM_STEPS):
            action = generator.uniform(-1, 1, settings.episode.action_size)
            if environment.step(action)[1].last():
                environment.reset()

    jobs["dm_control_default_renderer"] = (_DM_STEPS, run)
    return None


def _report(settings: Settings, rates: dict[str, float], reason: str | None) -> dict[str, object]:
    parts = {name[5:]: 1.0 / rate for name, rate in rates.items() if name.startswith("part_")}
    whole = 1.0 / rates["torchrl_with_images"]
    parts["interface"] = max(0.0, whole - sum(parts.values()))
    default = rates.get("dm_control_default_renderer")
    return {
        "machine": machine(),
        "gl": os.environ.get("MUJOCO_GL", "default"),
        "num_envs": settings.num_envs,
        "image_size": settings.image_size,
        "cams": list(settings.cams),
        "psm": settings.psm,
        "renderer": settings.engine.renderer,
        "steps_per_second": {
            name: round(rate) for name, rate in rates.items() if not name.startswith("part_")
        },
        "share_of_a_step": {name: round(part / whole, 3) for name, part in parts.items()},
        "ratio_to_default_renderer": None
        if default is None
        else round(rates["torchrl_with_images"] / default, 1),
        "default_renderer_missing": reason,
    }
