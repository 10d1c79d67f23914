"""Measures: renders the frames once, then trains a reader for each camera set.

A reader is the agent's encoders and trunk, trained to read facts off frames.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from tqdm import tqdm

from needlehoop.learning.encoder import Fold, convolution_dtype
from needlehoop.learning.job import pick_device
from needlehoop.learning.networks import Trunk
from needlehoop.probe.folder import Folder, errors_of
from needlehoop.probe.frames import Frames, collect
from needlehoop.probe.plan import CONSTANT, TRUTH, Plan
from needlehoop.probe.scores import constant, errors
from needlehoop.runs.files import seen
from needlehoop.runs.machine import available_cpus


def probe(plan: Plan, folder: Folder, progress: Callable[..., Any] = tqdm) -> None:
    """Measure every camera set of a plan that its folder lacks, and the baselines.

    Raises:
        ValueError: episodes that do not come to every phase.
    """
    todo = {
        seed: lacking
        for seed, lacking in missing(plan, folder.path).items()
        if lacking or not errors_of(folder.path, seed, CONSTANT).exists()
    }
    total = plan.fit.updates * sum(map(len, todo.values()))
    # One torch thread per reader: sums are then rounded alike at any number of threads.
    torch.set_num_threads(1)
    try:
        with progress(total=total, unit="update", dynamic_ncols=True) as bar:
            for seed, lacking in todo.items():
                _probe_seed(plan, folder, seed, lacking, bar)
    finally:
        if todo:
            folder.note()


def missing(plan: Plan, place: Path) -> dict[int, dict[str, tuple[str, ...]]]:
    """Camera sets that a folder lacks, with the true state, by seed and name."""
    wanted = {seen(one): one for one in plan.camera_sets} | {TRUTH: ()}
    return {
        seed: {
            name: one for name, one in wanted.items() if not errors_of(place, seed, name).exists()
        }
        for seed in range(plan.seeds)
    }


def _probe_seed(
    plan: Plan, folder: Folder, seed: int, lacking: Mapping[str, tuple[str, ...]], bar: tqdm
) -> None:
    cameras = tuple(dict.fromkeys(camera for one in lacking.values() for camera in one))
    sizes, done, found, fold = plan.episodes, 0, [], Fold(plan.encoder.stem)
    total = sizes.train + sizes.held_out

    def collected(more: int) -> None:
        nonlocal done
        done += more
        bar.set_description(f"seed {seed}: episode {done} of {total}")

    for episodes, own in zip((sizes.train, sizes.held_out), plan.episode_seeds(seed), strict=True):
        settings = replace(plan.env, cams=cameras, seed=own)
        frames = collect(settings, episodes, sizes.per_phase, collected)
        # Once, for all readers.
        images = {name: fold(image) for name, image in frames.images.items()}
        found.append(replace(frames, images=images))
    learnt, held_out = found

    def save(name: str, points: Tensor, fact: Tensor) -> None:
        found = errors(folder.asked, held_out, points, fact, sizes.held_out)
        folder.save(seed, name, *found)

    save(CONSTANT, *constant(folder.asked, learnt, held_out))
    bar.set_description(f"seed {seed}: {len(learnt)} + {len(held_out)} frames")
    stop = threading.Event()

    def updated() -> None:
        bar.update()
        if stop.is_set():
            raise KeyboardInterrupt

    def measure(name: str, reader: Reader) -> None:
        reader.learn(updated)
        save(name, *reader.read(held_out))

    with ThreadPoolExecutor(plan.env.engine.threads or available_cpus()) as pool:
        try:
            jobs = [
                pool.submit(measure, name, Reader(plan, learnt, own, seed))
                for name, own in lacking.items()
            ]
            for job in as_completed(jobs):
                job.result()
        finally:
            # Ctrl-C, or a reader that failed: the others need not end first.
            stop.set()
            pool.shutdown(cancel_futures=True)


class Reader:
    """The agent's encoders and trunk, with a linear layer that gives the answers.

    A seed gives the same weights, whatever other camera sets are missing. They are drawn here,
    from torch's global generator; ``learn`` draws minibatches from its own.

    Args:
        plan: the networks, and how they are trained.
        learnt: frames to learn from, folded for the encoder.
        cameras: whose images are read; none: the true state is.
    """

    def __init__(self, plan: Plan, learnt: Frames, cameras: Sequence[str], seed: int):
        self._fit, self._learnt, self._cameras, self._seed = plan.fit, learnt, cameras, seed
        self._device, stem = pick_device(plan.device), plan.encoder.stem
        torch.manual_seed(seed)
        shapes = {}
        for name in cameras:
            height, width, channels = learnt.images[name].shape[1:]
            # Trunk takes unfolded shapes.
            shapes[name] = torch.Size((channels // stem**2, height * stem, width * stem))
        vectors = {} if cameras else {TRUTH: learnt.state.shape[-1]}
        dtype = convolution_dtype(plan.precision, self._device)
        trunk = Trunk(shapes, vectors, plan.encoder, plan.heads, dtype)
        self._trunk = trunk.to(self._device)
        self._mean = learnt.points.mean(0)
        self._answers = nn.Linear(plan.heads.hidden, self._mean.numel() + 1).to(self._device)
        self._normalizers: list[Any] = list(trunk.normalizers.values())
        self._deviation = learnt.points.std(0).clamp(min=1e-3)

    def learn(self, updated: Callable[[], object]) -> None:
        """Train in minibatches; ``updated`` is called after each."""
        frames, fit = self._learnt, self._fit
        for normalizer in self._normalizers:
            normalizer.learn(frames.state.to(self._device))
        wanted = ((frames.points - self._mean) / self._deviation).flatten(1)
        weights = [*self._trunk.parameters(), *self._answers.parameters()]
        optimizer = torch.optim.Adam(weights, lr=fit.learning_rate)
        falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, fit.updates)
        generator = torch.Generator().manual_seed(self._seed)
        for _ in range(fit.updates):
            rows = torch.randint(len(frames), (fit.minibatch,), generator=generator)
            said = self._say(frames, rows)
            loss = functional.mse_loss(said[:, :-1], wanted[rows].to(self._device))
            loss = loss + functional.binary_cross_entropy_with_logits(
                said[:, -1], frames.fact[rows].float().to(self._device)
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            falling.step()
            updated()

    @torch.no_grad()
    def read(self, frames: Frames) -> tuple[Tensor, Tensor]:
        """``points`` and ``fact`` of frames that were not learnt from."""
        parts = [self._say(frames, rows).cpu() for rows in torch.arange(len(frames)).split(512)]
        said = torch.cat(parts)
        points = said[:, :-1].view(-1, *self._mean.shape) * self._deviation + self._mean
        return points, said[:, -1] > 0

    def _say(self, frames: Frames, rows: Tensor) -> Tensor:
        """Standardised points and, last, the logit of the fact, of chosen frames."""
        values = [frames.images[name] for name in self._cameras] or [frames.state]
        return self._answers(self._trunk(*(value[rows].to(self._device) for value in values)))
