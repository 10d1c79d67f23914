"""Random numbers that depend on nothing but seed, environment, episode, step and name.

So an episode is disturbed in the same way whatever runs beside it, and resuming needs no state.
"""

from __future__ import annotations

import zlib

import numpy as np
import torch
from torch import Tensor

_PERIOD = 2**18
"""Places in the tables at which an image's noise may begin."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def uniform(name: str, count: int, *keys: np.ndarray | int) -> np.ndarray:
    """Numbers in [0, 1), float64 ``(n, count)``: the finaliser of SplitMix64 over the keys.

    Args:
        name: what they are for; another name gives others.
        count: numbers for each row.
        keys: seed, environments, episodes, steps: integers, or ``(n,)`` of them.
    """
    state = np.full(1, zlib.crc32(name.encode()), np.uint64)
    for key in keys:
        state = _mixed(state ^ np.atleast_1d(np.asarray(key)).astype(np.uint64))
    columns = (1 + np.arange(count, dtype=np.uint64)) * _GOLDEN
    return (_mixed(state[:, None] + columns) >> np.uint64(11)) * 2.0**-53


def _mixed(state: np.ndarray) -> np.ndarray:
    state = state + _GOLDEN
    state = (state ^ (state >> np.uint64(30))) * _FIRST
    state = (state ^ (state >> np.uint64(27))) * _SECOND
    return state ^ (state >> np.uint64(31))


class Noise:
    """Noise of images, cut out of two tables that are always the same.

    Args:
        most: numbers of the largest image.
    """

    def __init__(self, most: int):
        generator = np.random.default_rng(0)
        size = _PERIOD + most
        self._normal = torch.from_numpy(generator.standard_normal(size, dtype=np.float32))
        self._uniform = torch.from_numpy(generator.random(size, dtype=np.float32))

    def normal(self, places: np.ndarray, shape: tuple[int, ...]) -> Tensor:
        """Standard normal numbers ``(n, *shape)``, float32.

        Args:
            places: where in the table each image's begin ``(n,)``, in [0, 1).
            shape: of an image.
        """
        return _cut(self._normal, places, shape)

    def uniform(self, places: np.ndarray, shape: tuple[int, ...]) -> Tensor:
        """Numbers in [0, 1), otherwise the same."""
        return _cut(self._uniform, places, shape)


def _cut(table: Tensor, places: np.ndarray, shape: tuple[int, ...]) -> Tensor:
    count = int(np.prod(shape))
    starts = (places * _PERIOD).astype(int).tolist()
    return torch.stack([table[at : at + count] for at in starts]).view(-1, *shape)
