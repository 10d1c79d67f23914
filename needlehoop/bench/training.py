"""Speed of training, and where its time goes."""

from __future__ import annotations

from dataclasses import replace

from needlehoop.bench.timing import Stopwatch, rounds_of
from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.runs.machine import available_cpus, machine, peak_memory


class _Training:
    """A training that is timed buffer by buffer; the first one warms up and is not counted."""

    def __init__(self, job: Job, rounds: int):
        self._job, self.watch, self.seconds = job, Stopwatch(), []
        self.learner = Learner(replace(job, steps=job.buffer * (rounds + 1)))
        self.watch.watch_learner(self.learner)
        self._buffers, self._warm = iter(self.learner), False

    def turn(self) -> None:
        _, spent = next(self._buffers)
        if self._warm:
            self.seconds.append(spent["seconds_collect"] + spent["seconds_update"])
        else:
            self.watch.seconds.clear()
        self._warm = True

    @property
    def rates(self) -> list[float]:
        """Steps per second of each buffer that counts."""
        return [self._job.buffer / one for one in self.seconds]

    @property
    def rate(self) -> float:
        """Steps per second of all of them."""
        return self._job.buffer * len(self.seconds) / sum(self.seconds)


def measure_training(job: Job, rounds: int, other: Job | None = None) -> dict[str, object]:
    """Environment steps per second of whole training, learning included.

    Stable-Baselines3 is measured elsewhere: its mere presence in the process slows this down.

    Args:
        job: what to train; its run is not written anywhere.
        rounds: buffers that are counted.
        other: trained in turns with it, buffer by buffer, to be compared.
    """
    trained = [_Training(one, rounds) for one in (job, other) if one is not None]
    for _ in rounds_of(rounds + 1, "buffer"):
        for one in trained:
            one.turn()
    own = trained[0]
    compared = {}
    if other is not None:
        ratios = [a / b for a, b in zip(own.rates, trained[1].rates, strict=True)]
        compared = {
            "steps_per_second_against": round(trained[1].rate),
            "ratio": round(own.rate / trained[1].rate, 3),
            "ratio_of_each_buffer": [round(one, 3) for one in ratios],
        }
    return {
        "machine": machine(),
        "device": str(own.learner.device),
        "encoder": job.encoder.name,
        "cams": list(job.env.cams),
        "image_size": job.env.image_size,
        "num_envs": job.env.num_envs,
        "threads": job.env.engine.threads or available_cpus(),
        "steps_per_second": round(own.rate),
        "steps_per_second_best_buffer": round(max(own.rates)),
        **compared,
        "hours_for_1.5_M_steps": round(1.5e6 / own.rate / 3600, 2),
        "peak_memory_gb": round(peak_memory(), 2),
        "share_of_time": own.watch.shares(
            sum(own.seconds), "physics", "images", "acting", "learning", rest="one_thread"
        ),
    }
