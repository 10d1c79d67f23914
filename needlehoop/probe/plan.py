"""What is to be probed; values in ``conf/probe.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from needlehoop.envs.settings import Settings
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.job import pick_device
from needlehoop.learning.networks import HeadConfig
from needlehoop.learning.precision import convolution_dtype
from needlehoop.probe.regression import Fit
from needlehoop.runs.files import SIGNALS, check_name, seen
from needlehoop.scene.cameras import parse_cameras

TRUTH, CONSTANT = SIGNALS, "constant"
"""Baselines beside the combinations: the true state read by the same trunk, and not looking."""

_SEEDS = 2_000_000
"""Episodes of the probe have seeds from here on, away from training's and evaluation's."""


@dataclass(frozen=True)
class Episodes:
    """How many, of each seed of the probe."""

    train: int
    held_out: int
    per_phase: int
    """Most frames of one phase of one episode."""

    def __post_init__(self) -> None:
        for key, least in (("train", 4), ("held_out", 4), ("per_phase", 1)):
            if getattr(self, key) < least:
                raise ValueError(f"episodes.{key}: {getattr(self, key)} must be at least {least}")


@dataclass(frozen=True)
class Scope:
    """How often, where to, and on what."""

    seeds: int
    """Probes with episodes and weights of their own, to see how far they agree."""
    results: str
    study: str
    overwrite: bool
    device: str
    precision: str

    def __post_init__(self) -> None:
        if self.seeds < 1:
            raise ValueError(f"seeds: {self.seeds} must be at least 1")
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
    found = []
    for one in given:
        names = one.split("+") if isinstance(one, str) else [str(name) for name in one]
        found.append(
            tuple(c.name for c in parse_cameras(names, settings.views, settings.renderings))
        )
    if not found or not all(found):
        raise ValueError("cams: nothing to probe; give combinations, such as rgb_front+rgb_side")
    for one in found:
        if found.count(one) > 1:
            raise ValueError(f"cams: {seen(one)} is named twice")
    return tuple(found)
