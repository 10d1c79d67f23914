"""Where things are when an episode begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from needlehoop.robot.geometry import about_z


@dataclass(frozen=True, eq=False)
class Start:
    """Where things are when an episode begins, ``n`` of them; m, rad, world frame.

    ``robot``: the robot's own numbers by name. ``free``: poses ``(n, 7)`` (position, quaternion)
    of free joints by name. ``mocap``: positions ``(n, 3)`` of mocap bodies by name; they are
    never turned. ``control`` ``(n, nu)``: servo commands that hold the start.
    """

    robot: Mapping[str, Tensor]
    free: Mapping[str, Tensor]
    mocap: Mapping[str, Tensor]
    control: Tensor

    def __len__(self) -> int:
        return len(self.control)

    def __getitem__(self, rows: int | slice) -> Start:
        """Some of them."""
        robot, free, mocap = (
            {name: value[rows] for name, value in one.items()}
            for one in (self.robot, self.free, self.mocap)
        )
        return Start(robot, free, mocap, self.control[rows])


def draws(seed: int, env: int, episode: int, count: int) -> np.ndarray:
    """The uniform numbers ``(count,)`` of one episode of one environment.

    Counter-based: they depend on nothing but the arguments, so an episode is the same
    whatever else runs beside it.
    """
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(env, episode))
    return np.random.Generator(np.random.Philox(sequence)).random(count)


def standing(places: Tensor, height: float, yaw: Tensor) -> Tensor:
    """Poses ``(n, 7)`` over ``places`` ``(n, 2)``, m, turned about z by ``yaw`` ``(n,)``, rad."""
    return torch.cat((places, torch.full_like(places[:, :1], height), about_z(yaw)), -1)


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
