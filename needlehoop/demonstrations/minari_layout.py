"""Minari's layout, through the minari library."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

from needlehoop.demonstrations.about import About
from needlehoop.demonstrations.flights import Flight


def check_name(name: str) -> None:
    """Raises ``ValueError`` for a folder's name that is no dataset's id for Minari."""
    if not re.fullmatch(r"[\w.-]+-v\d+", name):
        raise ValueError(
            f"out: {name!r} is no name for Minari, which wants a version: such as smooth-v0"
        )


def write(folder: Path, flights: Iterable[Flight], about: About) -> None:
    """Write a dataset whose id is its folder's name: ``demos/smooth-v0`` is ``smooth-v0``.

    Images are kept as they are (``jpeg_encoding=False``): Minari's default loses depth.
    ``infos`` has ``success``. Episodes are written one by one, so their number is no matter
    of memory.
    """
    import minari

    flights = iter(flights)
    first = next(flights)
    storage = MinariStorage.new(
        # Absolute: Minari joins a relative path to itself when it adds up the files' sizes.
        folder.resolve() / "data",
        observation_space=_observed(first),
        action_space=spaces.Box(-1.0, 1.0, first.actions.shape[1:], np.float32),
        jpeg_encoding=False,
    )
    storage.update_metadata(
        {
            "dataset_id": folder.name.removesuffix(".partial"),
            "algorithm_name": about.demonstrator,
            "description": f"A needle threaded through a hoop, {about.rate:g} steps a second,"
            f" by needlehoop: cams={','.join(about.settings.cams)} seed={about.settings.seed}",
            "minari_version": minari.__version__,
            "provenance": dict(about.provenance),
        }
    )
    for flight in chain([first], flights):
        storage.update_episodes([_episode(flight)])


def _observed(flight: Flight) -> spaces.Dict:
    images = {
        name: spaces.Box(0, 255, rows.shape[1:], np.uint8) for name, rows in flight.images.items()
    }
    vectors = {
        name: spaces.Box(-np.inf, np.inf, rows.shape[1:], np.float32)
        for name, rows in flight.vectors.items()
    }
    return spaces.Dict({**images, **vectors})


def _episode(flight: Flight) -> EpisodeBuffer:
    last = np.arange(len(flight)) == len(flight) - 1
    # Minari has a row of infos for each observation, the one after the reset included.
    success = np.append(False, last & flight.success)
    observations: Any = {**flight.images, **flight.vectors}
    rows: dict[str, Any] = {
        "observations": observations,
        "actions": flight.actions,
        "rewards": flight.rewards,
        "terminations": last & flight.terminated,
        "truncations": last & (not flight.terminated),
        "infos": {"success": success},
    }
    return EpisodeBuffer(**rows)
