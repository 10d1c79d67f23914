"""Speed of training, and where its time goes."""

from __future__ import annotations

from dataclasses import replace

from needlehoop.bench.timing import Stopwatch, rounds_of
from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.runs.machine import available_cpus, machine, peak_memory


def measure_training(job: Job, rounds: int) -> dict[str, object]:
    """Environment steps per second of whole training, learning included.

    The first buffer warms up and is not counted. Stable-Baselines3 is measured elsewhere: its
    mere presence in the process slows this down.
    """
    learner = Learner(replace(job, steps=job.buffer * (rounds + 1)))
    watch = Stopwatch()
    watch.watch_learner(learner)
    seconds, buffers = [], iter(learner)
    for number in rounds_of(rounds + 1, "buffer"):
        _, spent = next(buffers)
        seconds.append(spent["seconds_collect"] + spent["seconds_update"])
        if number == 0:
            watch.seconds.clear()
    counted = seconds[1:]
    rate = job.buffer * rounds / sum(counted)
    return {
        "machine": machine(),
        "device": str(learner.device),
        "encoder": job.encoder.name,
        "cams": list(job.env.cams),
        "image_size": job.env.image_size,
        "num_envs": job.env.num_envs,
        "threads": job.env.engine.threads or available_cpus(),
        "steps_per_second": round(rate),
        "steps_per_second_best_buffer": round(job.buffer / min(counted)),
        "hours_for_1.5_M_steps": round(1.5e6 / rate / 3600, 2),
        "peak_memory_gb": round(peak_memory(), 2),
        "share_of_time": watch.shares(
            sum(counted), "physics", "images", "acting", "learning", rest="one_thread"
        ),
    }
