"""What a probe measures: camera sets, episodes, a grid of views; values in ``conf/probe.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated, Any

from needlehoop.config import strict
from needlehoop.config.strict import Count, Range, Real
from needlehoop.envs.settings import Settings
from needlehoop.learning.encoder import EncoderConfig, convolution_dtype
from needlehoop.learning.job import pick_device
from needlehoop.learning.networks import HeadConfig
from needlehoop.runs.files import SIGNALS, check_folder, check_name, seen
from needlehoop.scene.cameras import View, parse_cameras

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
class Grid:
    """Views to map; angles in degrees, as in ``View``."""

    rendering: str
    like: str
    """View whose target, distance and depths the grid's cameras have."""
    fovy: float
    """Of the grid's cameras: wide enough for the scene from every side."""
    azimuths: tuple[Real, ...]
    elevations: tuple[Real, ...]

    def __post_init__(self) -> None:
        for key in ("azimuths", "elevations"):
            values = getattr(self, key)
            if len(values) < 2 or list(values) != sorted(set(values)):
                raise ValueError(f"grid.{key}: {list(values)} must be two or more, rising")

    def views(self, known: Mapping[str, View]) -> dict[str, View]:
        """The grid's views by name, such as ``az-30-el45``: row by row, an elevation each.

        Raises:
            ValueError: ``like`` is unknown, or an angle that no view can have.
        """
        strict.check_names("grid.like", [self.like], [*known])
        base = replace(known[self.like], fovy=self.fovy)
        if base.target is None:
            raise ValueError(f"grid.like: {self.like!r} has no target for the grid to look at")
        return {
            f"az{azimuth:g}-el{elevation:g}": replace(base, azimuth=azimuth, elevation=elevation)
            for elevation, azimuth in product(self.elevations, self.azimuths)
        }


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
    overwrite: bool
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


def camera_sets(given: Any, settings: Settings) -> tuple[tuple[str, ...], ...]:
    """Camera sets from a list of names with ``+`` between cameras, or of lists of cameras.

    Raises:
        ValueError: no camera set, an unknown camera, or a camera set named twice.
    """
    if isinstance(given, str):
        given = given.split(",")
    if not isinstance(given, list | tuple):
        raise ValueError(f"cams: {strict.shown(given)} is no list of camera sets")
    found = []
    for one in given:
        split = one.split("+") if isinstance(one, str) else one
        names = strict.structure(split, strict.Names, "cams")
        parse_cameras(names, settings.views, settings.renderings)
        found.append(names)
    if not found or not all(found):
        raise ValueError("cams: nothing to probe; give camera sets, such as rgb_front+rgb_side")
    for one in found:
        if found.count(one) > 1:
            raise ValueError(f"cams: {seen(one)} is named twice")
    return tuple(found)
