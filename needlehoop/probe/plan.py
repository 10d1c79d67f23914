"""What is to be probed; values in ``conf/probe.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import torch

from needlehoop.config import strict
from needlehoop.config.strict import Count, Range
from needlehoop.envs.settings import Settings
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.job import pick_device
from needlehoop.learning.networks import HeadConfig
from needlehoop.learning.precision import convolution_dtype
from needlehoop.probe.regression import Fit
from needlehoop.runs.files import SIGNALS, check_folder, check_name, seen
from needlehoop.scene.cameras import parse_cameras

TRUTH, CONSTANT = SIGNALS, "constant"
"""Baselines beside the combinations: the true state read by the same trunk, and not looking."""

_SEEDS = 2_000_000
"""Episodes of the probe have seeds from here on, away from training's and evaluation's."""


@dataclass(frozen=True)
class Episodes:
    """How many, of each seed of the probe."""

    train: Annotated[int, Range(4, 1_000_000)]
    held_out: Annotated[int, Range(4, 1_000_000)]
    per_phase: Count
    """Most frames of one phase of one episode."""


@dataclass(frozen=True)
class Scope:
    """How often, where to, and on what."""

    seeds: Annotated[int, Range(1, 1000)]
    """Probes with episodes and weights of their own, to see how far they agree."""
    results: str
    study: str
    overwrite: bool
    device: str
    precision: str

    def __post_init__(self) -> None:
        check_folder("results", self.results)
        check_name("study", self.study)
        convolution_dtype(self.precision, self.torch_device)

    @property
    def torch_device(self) -> torch.device:
        """Where networks are trained; errors as in ``pick_device``."""
        return pick_device(self.device)


@dataclass(frozen=True)
class Plan:
    """A probe of several combinations of cameras."""

    env: Settings
    """The scene, its views and renderings; its own cameras are ignored."""
    combinations: tuple[tuple[str, ...], ...]
    encoder: EncoderConfig
    heads: HeadConfig
    episodes: Episodes
    fit: Fit
    scope: Scope

    def __post_init__(self) -> None:
        self.encoder.check_fit(self.env.image_size)

    def episode_seeds(self, seed: int) -> tuple[int, int]:
        """Seeds of the training and of the held-out episodes; no two probes share any."""
        return _SEEDS + 2 * seed, _SEEDS + 2 * seed + 1


def combinations(given: Any, settings: Settings) -> tuple[tuple[str, ...], ...]:
    """Combinations as a command line gives them.

    Args:
        given: a list of names with ``+`` between cameras, or of lists of cameras.
        settings: views and renderings to choose from.

    Raises:
        ValueError: none, an unknown camera, or a combination that comes twice.
    """
    if isinstance(given, str):
        given = given.split(",")
    if not isinstance(given, list | tuple):
        raise ValueError(f"cams: {strict.told(given)} is no list of combinations")
    found = []
    for one in given:
        split = one.split("+") if isinstance(one, str) else one
        names = strict.structure(split, tuple[str, ...], "cams")
        found.append(
            tuple(c.name for c in parse_cameras(names, settings.views, settings.renderings))
        )
    if not found or not all(found):
        raise ValueError("cams: nothing to probe; give combinations, such as rgb_front+rgb_side")
    for one in found:
        if found.count(one) > 1:
            raise ValueError(f"cams: {seen(one)} is named twice")
    return tuple(found)
