"""Speed of training, where its time goes, and Stable-Baselines3 on the same task."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.learning.metrics import peak_memory
from needlehoop.runs.machine import available_cpus, machine

_SB3_ENVS, _SB3_STEPS = 8, 32
"""The paper's number of environments; steps of each per round, 256 in all: one minibatch."""


class Stopwatch:
    """Adds up the seconds spent in calls, by name."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def around(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """``call``, timed."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.seconds[name] += time.perf_counter() - began

        return timed


def measure_training(job: Job, rounds: int) -> dict[str, object]:
    """Environment steps per second of whole training, learning included.

    Ours and Stable-Baselines3's take turns in one process, so what else the machine does
    hits both; the first buffer of each warms up and is not counted.

    Args:
        job: what to train; its run is not written anywhere.
        rounds: buffers of ours that are counted.

    Raises:
        ValueError: ``rounds`` below 1, or no cameras.
    """
    if rounds < 1:
        raise ValueError(f"rounds: {rounds} must be at least 1")
    if not job.env.cams:
        raise ValueError("cams: the benchmark needs at least one camera")
    learner = Learner(replace(job, steps=job.buffer * (rounds + 1)))
    watch = _instrument(learner)
    other, reason = _other(job)
    # Memory is taken before Stable-Baselines3's first round adds its own.
    ours, theirs, memory = [], [], []
    buffers = iter(learner)
    for turn in range(rounds + 1):
        _, spent = next(buffers)
        ours.append(spent["seconds_collect"] + spent["seconds_update"])
        memory.append(peak_memory())
        if turn == 0:
            watch.seconds.clear()
        if other is not None:
            theirs.append(other())
    rate = job.buffer / (sum(ours[1:]) / rounds)
    best = job.buffer / min(ours[1:])
    found: dict[str, object] = {
        "machine": machine(),
        "device": str(learner.device),
        "encoder": job.encoder.name,
        "cams": list(job.env.cams),
        "image_size": job.env.image_size,
        "num_envs": job.env.num_envs,
        "steps_per_second": round(rate),
        "steps_per_second_best_buffer": round(best),
        "hours_for_1.5_M_steps": round(1.5e6 / rate / 3600, 2),
        "peak_memory_gb": round(memory[0], 2),
        "share_of_time": _shares(watch, sum(ours[1:])),
    }
    if other is None:
        return {**found, "stable_baselines3_missing": reason}
    sb3 = (len(theirs) - 1) / sum(1 / r for r in theirs[1:])
    return {
        **found,
        "stable_baselines3_steps_per_second": round(sb3, 1),
        "ratio_to_stable_baselines3": round(rate / sb3, 1),
    }


def _instrument(learner: Learner) -> Stopwatch:
    watch = Stopwatch()
    simulation = learner.env.simulation
    engine: Any = simulation.engine
    engine.step = watch.around("physics", engine.step)
    engine.render = watch.around("rendering", engine.render)
    learner.ppo.update = watch.around("update", learner.ppo.update)
    # The collector alone calls the agent as a whole.
    began: list[float] = []
    learner.agent.register_forward_pre_hook(lambda *_: began.append(time.perf_counter()))

    def after(*_: Any) -> None:
        watch.seconds["inference"] += time.perf_counter() - began.pop()

    learner.agent.register_forward_hook(after)
    return watch


def _shares(watch: Stopwatch, total: float) -> dict[str, float]:
    shares = {
        name: watch.seconds[name] / total
        for name in ("physics", "rendering", "inference", "update")
    }
    shares["rest"] = 1.0 - sum(shares.values())
    return {name: round(share, 3) for name, share in shares.items()}


def _other(job: Job) -> tuple[Callable[[], float] | None, str | None]:
    """One round of Stable-Baselines3, in steps per second; why not, where it can't be."""
    try:
        from needlehoop.bench.stable_baselines import build_sb3
    except ImportError as error:
        return None, f"{error}: pip install 'needlehoop[bench]'"
    steps = _SB3_ENVS * _SB3_STEPS
    try:
        model = build_sb3(job, _SB3_ENVS, _SB3_STEPS)
    except (AttributeError, OSError, RuntimeError) as error:
        # What a machine without OpenGL raises, by backend.
        return None, f"{type(error).__name__}: {error}"

    def run() -> float:
        # As a user of theirs has it: torch on all cores.
        torch.set_num_threads(available_cpus())
        began = time.perf_counter()
        model.learn(steps, reset_num_timesteps=False)
        seconds = time.perf_counter() - began
        torch.set_num_threads(1)
        return steps / seconds

    return run, None
