"""Speed of training, where its time goes, and what more cores would bring."""

from __future__ import annotations

from dataclasses import replace

from needlehoop.bench.scaling import predict, serial_share
from needlehoop.bench.stopwatch import Stopwatch
from needlehoop.bench.waiting import rounds_of
from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.learning.metrics import peak_memory
from needlehoop.runs.machine import available_cpus, machine


def measure_training(job: Job, rounds: int, *, alone: bool = False) -> dict[str, object]:
    """Environment steps per second of whole training, learning included.

    All threads and one thread take turns in one process, so what else the machine does hits
    both; the first buffer of each warms up and is not counted. Stable-Baselines3 is measured
    elsewhere: its mere presence in the process slows this down.

    Args:
        job: what to train; its run is not written anywhere.
        rounds: buffers of ours that are counted.
        alone: whether one thread takes no turns with all threads.

    Raises:
        ValueError: ``rounds`` below 1, or no cameras.
    """
    if rounds < 1:
        raise ValueError(f"rounds: {rounds} must be at least 1")
    if not job.env.cams:
        raise ValueError("cams: the benchmark needs at least one camera")
    threads = job.env.engine.threads or available_cpus()
    whole = _Turns(job, threads, rounds)
    whole.take()
    # Before the other adds its own.
    memory = peak_memory()
    single = None if alone or threads == 1 else _Turns(job, 1, rounds)
    for turn in rounds_of(rounds + 1, "buffer"):
        if turn:
            whole.take()
        if single is not None:
            single.take()
    found: dict[str, object] = {
        "machine": machine(),
        "device": str(whole.learner.device),
        "encoder": job.encoder.name,
        "cams": list(job.env.cams),
        "image_size": job.env.image_size,
        "num_envs": job.env.num_envs,
        "threads": threads,
        "steps_per_second": round(whole.rate),
        "steps_per_second_best_buffer": round(whole.best),
        "hours_for_1.5_M_steps": round(1.5e6 / whole.rate / 3600, 2),
        "peak_memory_gb": round(memory, 2),
        "share_of_time": whole.shares,
    }
    if single is None:
        return found
    return found | _scaling(whole.rate / single.rate, single, threads)


class _Turns:
    """A learner that trains a buffer at a time, timed; its first is not counted."""

    def __init__(self, job: Job, threads: int, rounds: int):
        env = replace(job.env, engine=replace(job.env.engine, threads=threads))
        self.learner = Learner(replace(job, env=env, steps=job.buffer * (rounds + 1)))
        self._watch = Stopwatch(self.learner)
        self._buffers = iter(self.learner)
        self._seconds: list[float] = []

    def take(self) -> None:
        """Train one buffer."""
        _, spent = next(self._buffers)
        self._seconds.append(spent["seconds_collect"] + spent["seconds_update"])
        if len(self._seconds) == 1:
            self._watch.clear()

    @property
    def rate(self) -> float:
        """Steps per second."""
        return self.learner.job.buffer * len(self._seconds[1:]) / sum(self._seconds[1:])

    @property
    def best(self) -> float:
        """Steps per second in the fastest buffer."""
        return self.learner.job.buffer / min(self._seconds[1:])

    @property
    def shares(self) -> dict[str, float]:
        """Of the time, by part."""
        found = self._watch.shares(sum(self._seconds[1:]))
        return {name: round(share, 3) for name, share in found.items()}


def _scaling(ratio: float, single: _Turns, threads: int) -> dict[str, object]:
    serial = serial_share(ratio, threads)
    return {
        "one_thread_steps_per_second": round(single.rate),
        "one_thread_share_of_time": single.shares,
        f"ratio_of_{threads}_threads_to_1": round(ratio, 2),
        "serial_share": round(serial, 3),
        "steps_per_second_predicted_by_cores": predict(single.rate, serial),
    }
