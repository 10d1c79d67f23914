"""Where things are when an episode begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorClass, TensorDict
from torch import Tensor


class Start(TensorClass):
    """Where things are when an episode begins; m, rad, world frame.

    ``robot``: the robot's own numbers by name. ``free``: poses ``(n, 7)`` (position, quaternion)
    of free joints by name. ``mocap``: positions ``(n, 3)`` of mocap bodies by name; they are
    never turned. ``control`` ``(n, nu)``: servo commands that hold the start.
    """

    robot: TensorDict
    free: TensorDict
    mocap: TensorDict
    control: Tensor


def draws(seed: int, env: int, episode: int, count: int) -> np.ndarray:
    """The uniform numbers ``(count,)`` of one episode of one environment.

    Counter-based: they depend on nothing but the arguments, so an episode is the same
    whatever else runs beside it.
    """
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(env, episode))
    return np.random.Generator(np.random.Philox(sequence)).random(count)


def scatter(uniform: Tensor, nominal: Sequence[float], half: Sequence[float]) -> Tensor:
    """Places ``(n, k)`` about nominal ones.

    Args:
        uniform: numbers in [0, 1) ``(n, k)``.
        nominal: the middle of each coordinate.
        half: half-width of each coordinate's range.
    """
    spread = 2.0 * uniform - 1.0
    columns = [c + h * spread[:, i] for i, (c, h) in enumerate(zip(nominal, half, strict=True))]
    return torch.stack(columns, -1)
