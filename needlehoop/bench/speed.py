"""Speed of the environment and of training, where the time goes, and plain dm_control beside it."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from statistics import harmonic_mean
from typing import Any

import mujoco
import numpy as np
import torch
from tqdm import tqdm

from needlehoop.envs.settings import Settings
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.runs.machine import available_cpus, machine, peak_memory

_DM_CONTROL_STEPS = 40
"""Per round."""

NO_OPENGL = (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError)
"""What a machine without OpenGL raises, depending on MuJoCo's backend."""

Work = tuple[int, Callable[[], None]]
"""A number of environment steps, and a call that takes them."""


def measure(settings: Settings, rounds: int, steps: int) -> dict[str, object]:
    """Environment steps per second, best of ``rounds`` rounds of ``steps`` vector steps.

    Every variant is timed once per round, so other work on the machine slows all of them.
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
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in rounds_of(rounds, "round"):
        for name, (_, run) in jobs.items():
            began = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - began)
    rates = {name: count / min(seconds[name]) for name, (count, _) in jobs.items()}
    default = rates.get("dm_control_default_renderer")
    return {
        **about(settings),
        "gl": os.environ.get("MUJOCO_GL", "default"),
        "psm": settings.psm,
        "renderer": settings.engine.renderer,
        "steps_per_second": {name: round(rate) for name, rate in rates.items()},
        "share_of_a_step": watch.shares(
            sum(seconds["torchrl_with_images"]), "physics", "images", rest="task_and_interface"
        ),
        "ratio_to_default_renderer": default and round(rates["torchrl_with_images"] / default, 1),
        "default_renderer_missing": missing,
    }


def measure_training(job: Job, rounds: int, other: Job | None) -> dict[str, object]:
    """Environment steps per second of whole training, learning included.

    Stable-Baselines3 is measured elsewhere: its mere presence in the process slows this down.
    No run is written.

    Args:
        rounds: buffers that are counted; one before them warms up.
        other: trained in turns with it, buffer by buffer, to be compared.
    """
    jobs = [job] if other is None else [job, other]
    learners = [Learner(replace(one, steps=one.buffer * (rounds + 1))) for one in jobs]
    turns = [iter(learner) for learner in learners]
    seconds: list[list[float]] = [[] for _ in jobs]
    learning: list[list[float]] = [[] for _ in jobs]
    for turn in rounds_of(rounds + 1, "buffer"):
        for own, spent, learnt in zip(turns, seconds, learning, strict=True):
            if turn == 1:
                spent.clear()
                learnt.clear()
            _, told = next(own)
            spent.append(told["seconds_collect"] + told["seconds_update"])
            learnt.append(told["seconds_update"])
    for learner in learners:
        learner.close()
    rates = [[one.buffer / s for s in spent] for one, spent in zip(jobs, seconds, strict=True)]
    rate, *against = [harmonic_mean(one) for one in rates]
    compared = {}
    if against:
        ratios = [round(a / b, 3) for a, b in zip(*rates, strict=True)]
        compared = {
            "steps_per_second_against": round(against[0]),
            "ratio": round(rate / against[0], 3),
            "ratio_of_each_buffer": ratios,
        }
    return {
        **about(job.env),
        "device": str(learners[0].device),
        "encoder": job.encoder.name,
        "threads": job.env.engine.threads or available_cpus(),
        "steps_per_second": round(rate),
        "steps_per_second_best_buffer": round(max(rates[0])),
        **compared,
        "hours_for_1.5_M_steps": round(1.5e6 / rate / 3600, 2),
        "peak_memory_gb": round(peak_memory(), 2),
        "share_learning": round(sum(learning[0]) / sum(seconds[0]), 3),
    }


def about(settings: Settings) -> dict[str, object]:
    """What every measurement says of itself."""
    return {
        "machine": machine(),
        "cams": list(settings.cams),
        "image_size": settings.image_size,
        "num_envs": settings.num_envs,
    }


def _random_steps(env: TorchRLEnv, steps: int) -> Work:
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


def _opengl_steps(settings: Settings) -> Work:
    """Steps of one dm_control environment that MuJoCo's default renderer draws; ``NO_OPENGL``."""
    # Finds an OpenGL library when it is imported, or raises.
    from needlehoop.bench.opengl import OpenGLEnvironment

    environment = OpenGLEnvironment(settings)
    environment.reset()
    generator = np.random.default_rng(settings.seed)

    def run() -> None:
        for _ in range(_DM_CONTROL_STEPS):
            action = generator.uniform(-1, 1, settings.episode.action_size)
            _, _, terminated, truncated, _ = environment.step(action)
            if terminated or truncated:
                environment.reset()

    return _DM_CONTROL_STEPS, run


def rounds_of(count: int, what: str) -> Iterator[int]:
    """``range(count)`` with a bar that counts ``what``; it draws between rounds, never in one."""
    # Its monitor thread would wake up in the middle of what is timed.
    tqdm.monitor_interval = 0
    yield from tqdm(range(count), desc="measuring", unit=what, leave=False, disable=None)


class Stopwatch:
    """Adds up the seconds that one thread spends in the parts of its work.

    Images are made by other threads while this one works out facts and rewards. They count for
    as long as this thread waits for them.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def watch_env(self, env: TorchRLEnv) -> None:
        """Time the physics and the images of an environment from now on."""
        engine: Any = env.simulation.engine
        engine.step = self._timed(engine.step, "physics")
        begin = env.threads.begin
        env.threads.begin = self._timed(lambda work: self._timed(begin(work), "images"), "images")

    def shares(self, total: float, *parts: str, rest: str) -> dict[str, float]:
        """Shares of ``total`` seconds by part; ``rest`` is what no part accounts for.

        They sum to 1, but for rounding to three digits.
        """
        shares = {name: self.seconds[name] / total for name in parts}
        shares[rest] = 1.0 - sum(shares.values())
        return {name: round(share, 3) for name, share in shares.items()}

    def _timed(self, call: Callable[..., Any], part: str) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.seconds[part] += time.perf_counter() - began

        return timed
