"""Speed of the environment with and without images, and of plain dm_control beside it.

    python benchmarks/environment.py 5 num_envs=80

The words are the number of rounds and settings of an environment. Every variant is timed once per
round with random actions, so other work on the machine slows all of them; the best round counts.
"""

import platform
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import torch

from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.runs.machine import available_cpus

STEPS = 40
"""Vector steps per round."""

NO_OPENGL = (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError)
"""What a machine without OpenGL raises, depending on MuJoCo's backend."""


def random_steps(env: TorchRLEnv) -> Callable[[], int]:
    """A call that takes a round's steps with random actions, and returns their number."""
    settings = env.settings
    generator = torch.Generator().manual_seed(settings.seed)
    shape = (STEPS, settings.num_envs, settings.episode.action_size)
    actions = 2.0 * torch.rand(shape, generator=generator) - 1.0
    now = env.reset()

    def run() -> int:
        nonlocal now
        for action in actions:
            now["action"] = action
            _, now = env.step_and_maybe_reset(now)
        return settings.num_envs * STEPS

    return run


def opengl_steps(settings: Settings) -> Callable[[], int]:
    """The same of one dm_control environment that MuJoCo's renderer draws; ``NO_OPENGL``."""
    # Finds an OpenGL library when it is imported, or raises.
    from opengl import OpenGLEnvironment

    environment = OpenGLEnvironment(settings)
    environment.reset()
    generator = np.random.default_rng(settings.seed)

    def run() -> int:
        for _ in range(STEPS):
            action = generator.uniform(-1, 1, settings.episode.action_size)
            _, _, terminated, truncated, _ = environment.step(action)
            if terminated or truncated:
                environment.reset()
        return STEPS

    return run


def timed(call: Callable[..., Any], seconds: dict[str, float], part: str) -> Callable[..., Any]:
    """A call that adds the time it takes to a part's."""

    def run(*args: Any, **kwargs: Any) -> Any:
        began = time.perf_counter()
        try:
            return call(*args, **kwargs)
        finally:
            seconds[part] += time.perf_counter() - began

    return run


def watch(env: TorchRLEnv) -> dict[str, float]:
    """The seconds that physics and images take from now on; images as long as they are awaited."""
    seconds: dict[str, float] = defaultdict(float)
    engine: Any = env.simulation.engine
    engine.step = timed(engine.step, seconds, "physics")
    begin = env.begin_look
    env.begin_look = timed(lambda *ids: timed(begin(*ids), seconds, "images"), seconds, "images")
    return seconds


if __name__ == "__main__":
    rounds, *words = sys.argv[1:]
    if not any(word.startswith("cams=") for word in words):
        words = ["cams=[dep_front,seg_side]", *words]
    settings = compose_settings(words)
    seeing = TorchRLEnv(settings)
    jobs = {
        "with images": random_steps(seeing),
        "without images": random_steps(TorchRLEnv(replace(settings, cams=()))),
    }
    try:
        jobs["dm_control, MuJoCo's renderer"] = opengl_steps(settings)
    except NO_OPENGL as error:
        print(f"no OpenGL: {type(error).__name__}: {error}")
    # The first steps warm up.
    jobs["with images"]()
    parts, spent = watch(seeing), 0.0
    best = dict.fromkeys(jobs, 0.0)
    for _ in range(int(rounds)):
        for name, run in jobs.items():
            began = time.perf_counter()
            count = run()
            seconds = time.perf_counter() - began
            best[name] = max(best[name], count / seconds)
            spent += seconds if name == "with images" else 0.0
    print(f"{platform.processor() or platform.machine()}, {available_cpus()} CPUs")
    for name, rate in best.items():
        print(f"{name}: {rate:,.0f} steps/s")
    shares = ", ".join(f"{part} {taken / spent:.0%}" for part, taken in parts.items())
    print(f"of a step with images: {shares}")
