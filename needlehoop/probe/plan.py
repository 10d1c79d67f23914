"""What a probe measures: camera sets, episodes, training; the values are in ``conf/probe.yaml``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from needlehoop.config import strict
from needlehoop.config.strict import Count, Range
from needlehoop.envs.settings import Settings
from needlehoop.learning.encoder import EncoderConfig, convolution_dtype
from needlehoop.learning.job import pick_device
from needlehoop.learning.networks import HeadConfig
from needlehoop.runs.files import SIGNALS, check_folder, check_name
from needlehoop.scene.cameras import parse_cameras

TRUTH, CONSTANT = SIGNALS, "constant"
"""Baselines beside the camera sets: the true state read by the same trunk, and a constant."""

_SEEDS = 2_000_000
"""The probe's seeds begin here, far from those of training and evaluation."""


@dataclass(frozen=True)
class Episodes:
    """How many episodes, for each seed of the probe."""

    train: Annotated[int, Range(4, 1_000_000)]
    held_out: Annotated[int, Range(4, 1_000_000)]
    per_phase: Count
    """Most frames of one phase of one episode."""


@dataclass(frozen=True)
class Fit:
    """How the network is trained."""

    updates: Count
    minibatch: Count
    learning_rate: Annotated[float, Range(0.0, 10.0, above=True)]
    """Of Adam at the start; falls to zero in a straight line."""


@dataclass(frozen=True)
class Plan:
    """A probe of several camera sets."""

    env: Settings
    """The scene, its views and renderings; its own cameras are ignored."""
    camera_sets: tuple[tuple[str, ...], ...]
    encoder: EncoderConfig
    heads: HeadConfig
    episodes: Episodes
    fit: Fit
    seeds: Annotated[int, Range(1, 1000)]
    """Repetitions, each with its own episodes and weights. They show how far probes agree."""
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


def camera_sets(given: str | list[Any], settings: Settings) -> tuple[tuple[str, ...], ...]:
    """Camera sets from a name with ``+`` between cameras, or a list of such or of lists of cameras.

    ``ValueError``: no camera set, an unknown camera, or a camera set named twice.
    """
    found = []
    for one in [given] if isinstance(given, str) else given:
        split = one.split("+") if isinstance(one, str) else one
        names = strict.structure(split, strict.Names, "cams")
        parse_cameras(names, settings.views, settings.renderings)
        found.append(names)
    if not found or not all(found):
        raise ValueError("cams: nothing to probe; give camera sets, such as rgb_front+rgb_side")
    if len(set(found)) < len(found):
        raise ValueError("cams: a camera set is named twice")
    return tuple(found)
