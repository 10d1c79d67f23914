"""Frames of good and bad episodes, and what a network should read off them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from needlehoop.envs.controllers import NOISE_MEMORY, controller
from needlehoop.envs.rollout import Step, batches, rollout
from needlehoop.envs.settings import Settings
from needlehoop.probe.quantities import Quantities, quantities
from needlehoop.scene.signals import Signals, columns

KINDS = ("expert", "perturbed", "random", "perturbed")
"""Who acts in episode ``i``: entry ``i % 4``."""

_NOISE = (0.1, 0.8)
"""Range of a perturbed episode's noise, in units of the action."""

_BATCH = 60


@dataclass(frozen=True)
class Frames:
    """``m`` frames.

    ``images`` ``(m, c, h, w)`` uint8 by camera; ``state`` ``(m, STATE_SIZE)`` float32, for the
    baseline that sees the true state; ``points`` ``(m, k, 3)`` float32, the ``k`` points of
    ``Quantities`` less its origin in mm, world axes; ``fact`` ``(m,)`` bool; ``phase`` ``(m,)``
    int64 into its phases; ``episode`` ``(m,)`` int64.
    """

    images: dict[str, Tensor]
    state: Tensor
    points: Tensor
    fact: Tensor
    phase: Tensor
    episode: Tensor

    def __len__(self) -> int:
        return len(self.phase)


def collect(
    settings: Settings, episodes: int, per_phase: int, tick: Callable[[int], object]
) -> Frames:
    """Frames of the first episode of ``episodes`` environments of the settings' seed.

    Every batch runs twice: once blind, to know each episode's phases, and once more to look at
    the steps that were chosen. An image costs more than a step.

    Args:
        settings: all cameras that are wanted; each view is rendered once for all its renderings.
        episodes: how many.
        per_phase: most frames of one phase of one episode, spread evenly over it.
        tick: called with the number of episodes that were added.

    Raises:
        ValueError: the task's phases give nothing to read off.
    """
    asked, parts = quantities(settings.definition), []
    for simulation in batches(settings, episodes, _BATCH):
        own, first = simulation.settings, int(simulation.envs[0])
        phases = [
            torch.where(step.alive, phase_of(asked, step.signals), -1)
            for step in rollout(simulation, _Cast(own, first))
        ]
        chosen = _spread(torch.stack(phases).numpy(), len(asked.phases), per_phase)
        simulation.reseed(settings.seed)
        parts += _look(asked, rollout(simulation, _Cast(own, first)), chosen, first)
        tick(own.num_envs)
    return _join(parts)


def phase_of(asked: Quantities, signals: Signals) -> Tensor:
    """Index of the phase ``(n,)`` int64 of each environment's moment.

    It is the phase after the last fact that holds; but the first phase until its own fact holds.
    A fact in between may be over again: what is put down is no longer high up.
    """
    index = torch.zeros(signals.batch_size, dtype=torch.int64)
    for number, phase in enumerate(asked.phases[:-1], 1):
        index = torch.where(getattr(signals, asked.ends[phase]), number, index)
    return torch.where(getattr(signals, asked.fact), index, 0)


class _Cast:
    """The controllers of a batch: environment ``i`` has the one that ``KINDS`` names.

    Args:
        settings: of the batch.
        first: index of its first environment.
    """

    def __init__(self, settings: Settings, first: int):
        who = [KINDS[(first + env) % len(KINDS)] for env in range(settings.num_envs)]
        self._expert = controller("expert", settings)
        self._size = settings.episode.action_size
        self._generator = torch.Generator().manual_seed(settings.seed + first)
        low, high = _NOISE
        amplitude = low + (high - low) * self._draw(settings.num_envs)
        self._random = torch.tensor([kind == "random" for kind in who]).unsqueeze(-1)
        perturbed = torch.tensor([kind == "perturbed" for kind in who])
        self._amplitude = (amplitude * perturbed).unsqueeze(-1)
        self._drift = torch.zeros(settings.num_envs, self._size, dtype=torch.float64)

    def __call__(self, signals: Signals) -> Tensor:
        uniform = 2.0 * self._draw(*self._drift.shape) - 1.0
        self._drift = NOISE_MEMORY * self._drift + uniform
        scripted = self._expert(signals) + self._amplitude * self._drift
        return torch.where(self._random, uniform, scripted.clamp(-1.0, 1.0))

    def _draw(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self._generator, dtype=torch.float64)


def _spread(phases: np.ndarray, number: int, most: int) -> np.ndarray:
    """At most ``most`` moments of each phase of each episode, evenly spread; bool as ``phases``."""
    chosen = np.zeros(phases.shape, dtype=bool)
    for env in range(phases.shape[1]):
        for phase in range(number):
            (at,) = np.nonzero(phases[:, env] == phase)
            picks = np.linspace(0, len(at) - 1, min(most, len(at))).round().astype(int)
            chosen[at[picks], env] = True
    return chosen


def _look(
    asked: Quantities, steps: Iterator[Step], chosen: np.ndarray, first: int
) -> Iterator[Frames]:
    """The chosen frames of a rollout, step by step."""
    for step, wanted in zip(steps, chosen, strict=True):
        ids = torch.from_numpy(np.flatnonzero(wanted))
        if len(ids):
            signals: Any = step.signals[ids]
            yield Frames(
                step.images(ids),
                columns(step.task.state, signals),
                _points(asked, signals),
                getattr(signals, asked.fact),
                phase_of(asked, signals),
                first + ids,
            )


def _points(asked: Quantities, signals: Signals) -> Tensor:
    origin = getattr(signals, asked.origin)
    places = [getattr(signals, name) - origin for name in asked.points]
    return 1e3 * torch.stack(places, 1).float()


def _join(parts: list[Frames]) -> Frames:
    return Frames(
        {name: torch.cat([part.images[name] for part in parts]) for name in parts[0].images},
        *(
            torch.cat([getattr(part, name) for part in parts])
            for name in ("state", "points", "fact", "phase", "episode")
        ),
    )
