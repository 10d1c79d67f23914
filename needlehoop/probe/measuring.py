"""What a probe measures, and how: frames are rendered once, then each camera set has a reader.

A reader is the agent's encoders and trunk, trained to read facts off frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from tqdm import tqdm

from needlehoop.config import strict
from needlehoop.config.strict import Count, Range
from needlehoop.envs.settings import Settings
from needlehoop.learning.algorithm_config import PpoConfig
from needlehoop.learning.encoder import EncoderConfig, Fold, convolution_dtype
from needlehoop.learning.job import pick_device
from needlehoop.learning.networks import Trunk
from needlehoop.probe.frames import Frames, collect, quantities
from needlehoop.probe.scores import CONSTANT, TRUTH, constant, errors, save
from needlehoop.runs.files import check_folder, check_name, seen
from needlehoop.scene.cameras import parse_cameras

_SEEDS = 2_000_000
"""The probe's seeds begin here, far from those of training and evaluation."""


Progress = Callable[[float], None]
"""Is told the share that is done; may raise to stop."""


@dataclass(frozen=True)
class Episodes:
    """How many episodes, for each seed of the probe."""

    train: Annotated[int, Range(4, 1_000_000)]
    held_out: Annotated[int, Range(4, 1_000_000)]
    per_phase: Count
    """Most frames of one phase of one episode."""


@dataclass(frozen=True)
class Fit:
    """How a reader is trained."""

    updates: Count
    minibatch: Count
    learning_rate: Annotated[float, Range(0.0, 10.0, above=True)]
    """Of Adam at the start; falls to zero in a straight line."""


@dataclass(frozen=True)
class Plan:
    """A probe of several camera sets; the values are in ``conf/probe.yaml``."""

    env: Settings
    """The scene, its views and renderings; its own cameras are ignored."""
    camera_sets: tuple[tuple[str, ...], ...]
    encoder: EncoderConfig
    algo: PpoConfig
    """Of which the network counts."""
    episodes: Episodes
    fit: Fit
    seeds: Annotated[int, Range(1, 1000)]
    """Repetitions, each with its own episodes and weights."""
    results: str
    study: str
    device: str
    precision: str

    def __post_init__(self) -> None:
        check_folder("results", self.results)
        check_name("study", self.study)
        convolution_dtype(self.precision, pick_device(self.device))
        self.encoder.check_fit(self.env.image_size)

    def episode_seeds(self, seed: int) -> tuple[int, int]:
        """Seeds of the training and of the held-out episodes; no two probes share any."""
        return _SEEDS + 2 * seed, _SEEDS + 2 * seed + 1


def camera_sets(names: Any, settings: Settings) -> tuple[tuple[str, ...], ...]:
    """Camera sets from their names, with ``+`` between cameras.

    ``ValueError``: no camera set, an unknown camera, or a camera set named twice.
    """
    sets = tuple(tuple(name.split("+")) for name in strict.structure(names, strict.Names, "cams"))
    for cameras in sets:
        parse_cameras(cameras, settings.views, settings.renderings)
    if not sets or len({*sets}) < len(sets):
        raise ValueError("cams: give camera sets, such as rgb_front+rgb_side, each once")
    return sets


def probe(plan: Plan, folder: Path, progress: Progress = lambda _: None) -> None:
    """Measure every camera set of a plan and the baselines, into a folder.

    ``ValueError``: episodes that do not come to every phase.
    """
    # One torch thread per reader: sums are then rounded alike at any number of threads.
    torch.set_num_threads(1)
    with tqdm(total=plan.seeds * (len(plan.camera_sets) + 1), unit="set") as bar:
        for seed in range(plan.seeds):
            bar.set_description(f"seed {seed}")
            progress(bar.n / bar.total)
            _probe_seed(plan, folder, seed, bar, progress)


def _probe_seed(plan: Plan, folder: Path, seed: int, bar: tqdm, progress: Progress) -> None:
    targets, sizes, fold = quantities(plan.env.definition), plan.episodes, Fold(plan.encoder.stem)
    cameras = tuple(dict.fromkeys(camera for cams in plan.camera_sets for camera in cams))
    parts = []
    for n, env_seed in zip((sizes.train, sizes.held_out), plan.episode_seeds(seed), strict=True):
        frames = collect(replace(plan.env, cams=cameras, seed=env_seed), n, sizes.per_phase)
        # Once, for all readers.
        images = {name: fold(image) for name, image in frames.images.items()}
        parts.append(replace(frames, images=images))
    learnt, held_out = parts

    def keep(name: str, points: Tensor, fact: Tensor) -> None:
        means, counts = errors(targets, held_out, points, fact, sizes.held_out)
        save(folder / f"seed{seed}/{name}.csv", targets, means, counts)

    def measure(name: str, reader: Reader) -> None:
        reader.learn()
        keep(name, *reader.read(held_out))
        bar.update()
        progress(bar.n / bar.total)

    keep(CONSTANT, *constant(targets, learnt, held_out))
    sets = {seen(cams): cams for cams in plan.camera_sets} | {TRUTH: ()}
    readers = [Reader(plan, learnt, cams, seed) for cams in sets.values()]
    with ThreadPoolExecutor(plan.env.engine.cpus) as pool:
        # After an error or Ctrl-C, this cancels what has not begun.
        list(pool.map(measure, sets, readers))


class Reader:
    """The agent's encoders and trunk, with a linear layer that gives the answers.

    A seed gives the same weights, whatever other camera sets are measured. They are drawn here,
    from torch's global generator; ``learn`` draws minibatches from its own. ``learnt``: frames to
    learn from, folded for the encoder. ``cameras``: none to read the true state.
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
        network = plan.algo.network
        trunk = Trunk(shapes, vectors, plan.encoder, network, dtype)
        self._trunk = trunk.to(self._device)
        self._mean = learnt.points.mean(0)
        self._answers = nn.Linear(network.hidden, self._mean.numel() + 1).to(self._device)
        self._normalizers: list[Any] = list(trunk.normalizers.values())
        self._deviation = learnt.points.std(0).clamp(min=1e-3)

    def learn(self) -> None:
        """Train in minibatches."""
        frames, fit = self._learnt, self._fit
        for normalizer in self._normalizers:
            normalizer.learn(frames.state.to(self._device))
        points = ((frames.points - self._mean) / self._deviation).flatten(1)
        weights = [*self._trunk.parameters(), *self._answers.parameters()]
        optimizer = torch.optim.Adam(weights, lr=fit.learning_rate)
        falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, fit.updates)
        generator = torch.Generator().manual_seed(self._seed)
        for _ in range(fit.updates):
            rows = torch.randint(len(frames), (fit.minibatch,), generator=generator)
            outputs = self._say(frames, rows)
            loss = functional.mse_loss(outputs[:, :-1], points[rows].to(self._device))
            loss = loss + functional.binary_cross_entropy_with_logits(
                outputs[:, -1], frames.fact[rows].float().to(self._device)
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            falling.step()

    @torch.no_grad()
    def read(self, frames: Frames) -> tuple[Tensor, Tensor]:
        """``points`` and ``fact`` of frames that were not learnt from."""
        parts = [self._say(frames, rows).cpu() for rows in torch.arange(len(frames)).split(512)]
        outputs = torch.cat(parts)
        points = outputs[:, :-1].view(-1, *self._mean.shape) * self._deviation + self._mean
        return points, outputs[:, -1] > 0

    def _say(self, frames: Frames, rows: Tensor) -> Tensor:
        """Standardised points and, last, the logit of the fact, of chosen frames."""
        values = [frames.images[name] for name in self._cameras] or [frames.state]
        return self._answers(self._trunk(*(value[rows].to(self._device) for value in values)))
