"""Speed of the environment, where the time goes, and the same scene in plain dm_control."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import torch

from needlehoop.bench.timing import Stopwatch, rounds_of
from needlehoop.envs.settings import Settings
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.runs.machine import machine

DM_CONTROL_STEPS = 40
"""Steps of the single dm_control environment per round."""

NO_OPENGL = (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError)
"""What a machine without OpenGL raises, depending on MuJoCo's backend."""

Job = tuple[int, Callable[[], None]]
"""A number of environment steps, and a call that takes them."""


def measure(settings: Settings, rounds: int, steps: int) -> dict[str, object]:
    """Environment steps per second, best of ``rounds`` rounds, all in one process.

    Every variant is timed once per round, so other work on the machine slows all of them.

    Args:
        steps: vector steps per timing.
    """
    seeing, watch = TorchRLEnv(settings), Stopwatch()
    jobs = {
        "torchrl_with_images": _random_steps(seeing, steps),
        "torchrl_without_images": _random_steps(TorchRLEnv(replace(settings, cams=())), steps),
    }
    # Its first steps warm up and are not counted.
    jobs["torchrl_with_images"][1]()
    watch.watch_env(seeing)
    try:
        jobs["dm_control_default_renderer"] = _opengl_steps(settings)
        missing = None
    except NO_OPENGL as error:
        missing = f"{type(error).__name__}: {error}"
    rates, seconds = dict.fromkeys(jobs, 0.0), dict.fromkeys(jobs, 0.0)
    for _ in rounds_of(rounds, "round"):
        for name, (count, job) in jobs.items():
            began = time.perf_counter()
            job()
            taken = time.perf_counter() - began
            rates[name], seconds[name] = max(rates[name], count / taken), seconds[name] + taken
    default = rates.get("dm_control_default_renderer")
    return {
        "machine": machine(),
        "gl": os.environ.get("MUJOCO_GL", "default"),
        "num_envs": settings.num_envs,
        "image_size": settings.image_size,
        "cams": list(settings.cams),
        "psm": settings.psm,
        "renderer": settings.engine.renderer,
        "steps_per_second": {name: round(rate) for name, rate in rates.items()},
        "share_of_a_step": watch.shares(
            seconds["torchrl_with_images"], "physics", "images", rest="task_and_interface"
        ),
        "ratio_to_default_renderer": None
        if default is None
        else round(rates["torchrl_with_images"] / default, 1),
        "default_renderer_missing": missing,
    }


def _random_steps(env: TorchRLEnv, steps: int) -> Job:
    """Steps with random actions; an episode that ends is followed by the next one."""
    settings = env.settings
    generator = torch.Generator().manual_seed(settings.seed)
    shape = (settings.num_envs, settings.episode.action_size)
    actions = [2.0 * torch.rand(shape, generator=generator) - 1.0 for _ in range(steps)]
    now = env.reset()

    def run() -> None:
        nonlocal now
        for action in actions:
            now["action"] = action
            _, now = env.step_and_maybe_reset(now)

    return settings.num_envs * steps, run


def _opengl_steps(settings: Settings) -> Job:
    """Steps of one dm_control environment that MuJoCo's default OpenGL renderer draws.

    Raises:
        one of ``NO_OPENGL``: this machine has no OpenGL.
    """
    # Finds an OpenGL library when it is imported, or raises.
    from needlehoop.pictures.opengl import OpenGLEnvironment

    environment = OpenGLEnvironment(settings)
    environment.reset()
    generator = np.random.default_rng(settings.seed)

    def run() -> None:
        for _ in range(DM_CONTROL_STEPS):
            action = generator.uniform(-1, 1, settings.episode.action_size)
            if environment.step(action)[1].last():
                environment.reset()

    return DM_CONTROL_STEPS, run
