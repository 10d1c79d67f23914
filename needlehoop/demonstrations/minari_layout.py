"""Minari's layout, through the minari library."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import minari
import numpy as np
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

from needlehoop.demonstrations.episodes import Demonstration
from needlehoop.envs.settings import Settings


def write(
    folder: Path,
    episodes: Iterable[Demonstration],
    settings: Settings,
    demonstrator: str,
    provenance: Mapping[str, Any],
) -> None:
    """Write a dataset whose id is its folder's name: ``demos/smooth-v0`` is ``smooth-v0``.

    Images are kept as they are (``jpeg_encoding=False``): Minari's default loses depth.
    ``infos`` has ``success``. Episodes are written one by one, to save memory.
    """
    episodes = iter(episodes)
    first = next(episodes)
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
            "algorithm_name": demonstrator,
            "description": f"{settings.definition.summary} {1 / settings.period:g} steps a second,"
            f" by needlehoop: cams={','.join(settings.cams)} seed={settings.seed}",
            "minari_version": minari.__version__,
            "provenance": dict(provenance),
        }
    )
    for episode in chain([first], episodes):
        storage.update_episodes([_episode(episode)])


def _observed(episode: Demonstration) -> spaces.Dict:
    boxes: dict[str, spaces.Space] = {}
    for name, rows in episode.images.items():
        boxes[name] = spaces.Box(0, 255, rows.shape[1:], np.uint8)
    for name, rows in episode.vectors.items():
        boxes[name] = spaces.Box(-np.inf, np.inf, rows.shape[1:], np.float32)
    return spaces.Dict(boxes)


def _episode(episode: Demonstration) -> EpisodeBuffer:
    last = np.arange(len(episode)) == len(episode) - 1
    # Minari has a row of infos for each observation, the one after the reset included.
    success = np.append(False, last & episode.success)
    rows: dict[str, Any] = {
        "observations": {**episode.images, **episode.vectors},
        "actions": episode.actions,
        "rewards": episode.rewards,
        "terminations": last & episode.terminated,
        "truncations": last & (not episode.terminated),
        "infos": {"success": success},
    }
    return EpisodeBuffer(**rows)
