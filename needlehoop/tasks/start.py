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
    """Where things are when ``n`` episodes begin; m, rad, world frame."""

    robot: Mapping[str, Tensor]
    """The robot's own numbers by name."""
    free: Mapping[str, Tensor]
    """Poses ``(n, 7)`` (position, quaternion) of free joints by name."""
    mocap: Mapping[str, Tensor]
    """Positions ``(n, 3)`` of mocap bodies by name; they are never turned."""
    control: Tensor
    """Servo commands ``(n, nu)`` that hold the start."""

    def __len__(self) -> int:
        return len(self.control)


NUMBERS = 64
"""Uniform numbers that are drawn for an episode; a task takes as many as it needs."""


def draws(seed: int, env: int, episode: int) -> np.ndarray:
    """The uniform numbers ``(NUMBERS,)`` of one episode of one environment.

    They depend on the arguments alone, so an episode is the same whatever runs beside it.
    """
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(env, episode))
    return np.random.Generator(np.random.Philox(sequence)).random(NUMBERS)


class Chance:
    """Gives out uniform numbers ``(n, NUMBERS)`` of ``n`` episodes, one after the other."""

    def __init__(self, uniform: Tensor):
        self._numbers, self._taken = uniform.unbind(-1), 0

    def number(self) -> Tensor:
        """The next number of each episode ``(n,)``; ``ValueError`` if there is none left."""
        if self._taken == len(self._numbers):
            raise ValueError(f"start: it takes more than {self._taken} numbers an episode")
        self._taken += 1
        return self._numbers[self._taken - 1]

    def about(self, nominal: float, half: float) -> Tensor:
        """A number ``(n,)``, uniform within ``half`` of a nominal one."""
        return nominal + half * (2.0 * self.number() - 1.0)

    def place(self, nominal: Sequence[float], half: Sequence[float]) -> Tensor:
        """Places ``(n, k)``, each coordinate ``about`` its own nominal one."""
        return torch.stack([self.about(*one) for one in zip(nominal, half, strict=True)], -1)


def standing(places: Tensor, height: float, yaw: Tensor) -> Tensor:
    """Poses ``(n, 7)`` over ``places`` ``(n, 2)``, m, turned about z by ``yaw`` ``(n,)``, rad."""
    return torch.cat((places, torch.full_like(places[:, :1], height), about_z(yaw)), -1)
