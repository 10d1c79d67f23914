"""Measures: renders the frames once, then trains a reader for each camera set.

A reader is the agent's encoders and trunk, trained to read facts off frames.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from tqdm import tqdm

from needlehoop.learning.encoder import EncoderConfig, Fold, convolution_dtype
from needlehoop.learning.networks import HeadConfig, Trunk
from needlehoop.probe.folder import Folder, errors_of
from needlehoop.probe.frames import Frames, Reading, collect
from needlehoop.probe.plan import CONSTANT, TRUTH, Fit, Plan
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


_STATE = "signals"


class Reader:
    """The agent's encoders and trunk, with a linear layer that gives the answers.

    Weights are drawn here, from torch's global generator; ``learn`` draws from its own.

    Args:
        frames: to learn from, folded by ``fold``.
        cameras: whose images are read; none: the true state is.
        encoder: of every camera.
        heads: width and layers of the trunk.
        dtype: of the convolutions.
        device: where it is trained.
    """

    def __init__(
        self,
        frames: Frames,
        cameras: Sequence[str],
        encoder: EncoderConfig,
        heads: HeadConfig,
        dtype: torch.dtype,
        device: torch.device,
    ):
        self._cameras, self._device = tuple(cameras), device
        # Trunk takes unfolded shapes: (c, h, w).
        images = {name: _unfolded(frames.images[name].shape[1:], encoder.stem) for name in cameras}
        vectors = {} if cameras else {_STATE: frames.state.shape[-1]}
        trunk = Trunk(images, vectors, encoder, heads, dtype)
        self._trunk = trunk.to(device)
        self._mean = frames.points.mean(0)
        self._answers = nn.Linear(heads.hidden, self._mean.numel() + 1).to(device)
        self._normalizers: list[Any] = list(trunk.normalizers.values())
        self._deviation = frames.points.std(0).clamp(min=1e-3)

    def learn(self, frames: Frames, fit: Fit, seed: int, tick: Callable[[], object]) -> None:
        """Train on frames, in minibatches drawn by ``seed``; ``tick`` is called after each."""
        for normalizer in self._normalizers:
            normalizer.learn(frames.state.to(self._device))
        wanted = ((frames.points - self._mean) / self._deviation).flatten(1)
        weights = [*self._trunk.parameters(), *self._answers.parameters()]
        optimizer = torch.optim.Adam(weights, lr=fit.learning_rate)
        falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, fit.updates)
        generator = torch.Generator().manual_seed(seed)
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
            tick()

    @torch.no_grad()
    def read(self, frames: Frames) -> Reading:
        """Read frames that were not learnt from."""
        parts = [self._say(frames, rows).cpu() for rows in torch.arange(len(frames)).split(512)]
        said = torch.cat(parts)
        points = said[:, :-1].view(-1, *self._mean.shape) * self._deviation + self._mean
        return Reading(points, said[:, -1] > 0)

    def _say(self, frames: Frames, rows: Tensor) -> Tensor:
        """Standardised points and, last, the logit of the fact, of chosen frames."""
        values = [frames.images[name] for name in self._cameras] or [frames.state]
        return self._answers(self._trunk(*(value[rows].to(self._device) for value in values)))


def fold(frames: Frames, stem: int) -> Frames:
    """Frames with their images folded for an encoder: once, for all readers."""
    folder = Fold(stem)
    images = {name: folder(image) for name, image in frames.images.items()}
    return replace(frames, images=images)


def _unfolded(shape: torch.Size, stem: int) -> torch.Size:
    height, width, channels = shape
    return torch.Size((channels // stem**2, height * stem, width * stem))
