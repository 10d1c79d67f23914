"""Measures: renders the frames once, then trains a reader for each camera set."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import torch
from tqdm import tqdm

from needlehoop.learning.encoder import convolution_dtype
from needlehoop.probe.folder import Folder, errors_of
from needlehoop.probe.frames import Frames, collect
from needlehoop.probe.plan import CONSTANT, TRUTH, Plan
from needlehoop.probe.reader import Reader, fold
from needlehoop.probe.scores import constant, errors
from needlehoop.runs.files import seen
from needlehoop.runs.machine import available_cpus


def probe(plan: Plan, folder: Folder) -> None:
    """Measure every camera set of a plan that its folder lacks, and the baselines.

    Raises:
        ValueError: episodes that do not come to every phase.
    """
    todo = missing(plan, folder.path)
    total = plan.fit.updates * sum(map(len, todo.values()))
    # One torch thread per reader: sums are then rounded alike at any number of threads.
    torch.set_num_threads(1)
    with tqdm(total=total, unit="update", dynamic_ncols=True) as bar:
        for seed, lacking in todo.items():
            if lacking or not folder.has(seed, CONSTANT):
                _probe_seed(plan, folder, seed, lacking, bar)


def missing(plan: Plan, place: Path) -> dict[int, dict[str, tuple[str, ...]]]:
    """Camera sets that a folder lacks, with the true state, by seed and name.

    The folder need not exist.
    """
    wanted = {seen(one): one for one in plan.camera_sets} | {TRUTH: ()}
    return {
        seed: {
            name: one for name, one in wanted.items() if not errors_of(place, seed, name).exists()
        }
        for seed in range(plan.effort.seeds)
    }


def _probe_seed(
    plan: Plan, folder: Folder, seed: int, lacking: Mapping[str, tuple[str, ...]], bar: tqdm
) -> None:
    learnt, held_out = _frames(plan, seed, lacking.values(), bar)
    episodes, asked = plan.episodes.held_out, folder.asked
    blind = constant(asked, learnt, held_out)
    folder.save(seed, CONSTANT, *errors(asked, held_out, blind, episodes))
    bar.set_description(f"seed {seed}: {len(learnt)} + {len(held_out)} frames")
    stop = threading.Event()

    def tick() -> None:
        bar.update()
        if stop.is_set():
            raise KeyboardInterrupt

    def measure(name: str, reader: Reader) -> None:
        reader.learn(learnt, plan.fit, seed, tick)
        folder.save(seed, name, *errors(asked, held_out, reader.read(held_out), episodes))

    threads = plan.env.engine.threads or available_cpus()
    with ThreadPoolExecutor(threads) as pool:
        try:
            jobs = [
                pool.submit(measure, name, _reader(plan, learnt, cameras, seed))
                for name, cameras in lacking.items()
            ]
            for job in as_completed(jobs):
                job.result()
        finally:
            # Ctrl-C, or a reader that failed: the others need not end first.
            stop.set()
            pool.shutdown(cancel_futures=True)


def _frames(
    plan: Plan, seed: int, camera_sets: Iterable[tuple[str, ...]], bar: tqdm
) -> tuple[Frames, Frames]:
    """Frames to learn from and held-out ones, folded."""
    cameras = tuple(dict.fromkeys(camera for one in camera_sets for camera in one))
    sizes = (plan.episodes.train, plan.episodes.held_out)
    done, found = 0, []

    def tick(more: int) -> None:
        nonlocal done
        done += more
        bar.set_description(f"seed {seed}: episode {done} of {sum(sizes)}")

    for episodes, own in zip(sizes, plan.episode_seeds(seed), strict=True):
        settings = replace(plan.env, cams=cameras, seed=own)
        frames = collect(settings, episodes, plan.episodes.per_phase, tick)
        found.append(fold(frames, plan.encoder.stem))
    return found[0], found[1]


def _reader(plan: Plan, learnt: Frames, cameras: Sequence[str], seed: int) -> Reader:
    """A seed gives the same weights, whatever other camera sets are missing."""
    device = plan.effort.torch_device
    torch.manual_seed(seed)
    dtype = convolution_dtype(plan.effort.precision, device)
    return Reader(learnt, cameras, plan.encoder, plan.heads, dtype, device)
