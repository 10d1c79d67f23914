"""Speed of whole training, learning included; alone, or in turns with another training.

    python benchmarks/training.py 3 num_envs=80 against disturb=mild

The words are the number of buffers that are counted, settings of ``python train.py``, and after
``against`` what the other training has besides. One buffer before them warms up. No run is written.
The last line is JSON.
"""

import json
import platform
import sys
from dataclasses import replace
from statistics import harmonic_mean

from needlehoop.config import composing
from needlehoop.learning.job import Job, typed_job
from needlehoop.learning.learner import Learner
from needlehoop.runs.machine import available_cpus, peak_memory


def job_of(words: list[str]) -> Job:
    """A training's settings, with two cameras where none are named."""
    cams = [] if any(word.startswith("cams=") for word in words) else ["cams=[dep_front,seg_side]"]
    return typed_job(composing.compose([*cams, *words], "job"))


def measure(jobs: list[Job], rounds: int) -> tuple[list[list[float]], list[float]]:
    """Steps per second of each training in each buffer, and the share of its time that learns."""
    learners = [Learner(replace(job, steps=job.buffer * (rounds + 1))) for job in jobs]
    turns = [iter(learner) for learner in learners]
    spent: list[list[float]] = [[] for _ in jobs]
    learning = [0.0 for _ in jobs]
    for turn in range(rounds + 1):
        for number, buffers in enumerate(turns):
            _, losses = next(buffers)
            if turn:
                spent[number].append(losses["seconds_collect"] + losses["seconds_update"])
                learning[number] += losses["seconds_update"]
    for learner in learners:
        learner.close()
    rates = [[job.buffer / s for s in seconds] for job, seconds in zip(jobs, spent, strict=True)]
    return rates, [part / sum(seconds) for part, seconds in zip(learning, spent, strict=True)]


if __name__ == "__main__":
    rounds, *words = sys.argv[1:]
    more: list[str] | None = None
    if "against" in words:
        at = words.index("against")
        words, more = words[:at], words[at + 1 :]
    jobs = [job_of(words)] if more is None else [job_of(words), job_of([*words, *more])]
    rates, learning = measure(jobs, int(rounds))
    means = [harmonic_mean(speeds) for speeds in rates]
    report = {
        "machine": platform.processor() or platform.machine(),
        "threads": jobs[0].env.engine.threads or available_cpus(),
        "steps_per_second": round(means[0]),
        "share_learning": round(learning[0], 3),
        "peak_memory_gb": round(peak_memory(), 2),
    }
    if more is not None:
        report["steps_per_second_against"] = round(means[1])
        report["ratio_of_each_buffer"] = [round(a / b, 3) for a, b in zip(*rates, strict=True)]
    print(json.dumps(report))
