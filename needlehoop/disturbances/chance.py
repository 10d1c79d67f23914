"""Random numbers that depend on nothing but seed, environment, episode, step and name.

So an episode is disturbed in the same way whatever runs beside it, and resuming needs no state.
"""

from __future__ import annotations

import zlib

import numpy as np

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
