"""Frames of good and bad episodes, and what a network should read off them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from needlehoop.envs.controllers import NOISE_MEMORY, Controller, batches, controller, rollout
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.signals import Signals, columns
from needlehoop.tasks.contract import Task

KINDS = ("expert", "perturbed", "random", "perturbed")
"""Who acts in episode ``i``: entry ``i % 4``."""

_NOISE = (0.1, 0.8)
"""Range of a perturbed episode's noise, in units of the action."""

_BATCH = 60


@dataclass(frozen=True)
class Quantities:
    """What is read off a task's frames, by the names that tables and files use."""

    task: str
    ends: Mapping[str, str]
    """By phase, in order: the fact that ends it."""
    origin: str
    """The signal that places are relative to: the second point of the last phase."""
    points: tuple[str, ...]
    """Signals whose places relative to the origin are read off: those of the last phase first."""
    gaps: Mapping[str, tuple[str, str]]
    """Ways between two of the points, by name."""
    needed: Mapping[str, str]
    """By phase: the point or the gap that has to be known in it."""

    @property
    def phases(self) -> tuple[str, ...]:
        return tuple(self.ends)

    @property
    def fact(self) -> str:
        """The one that is read off: it ends the first phase."""
        return self.ends[self.phases[0]]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all errors: in mm; of ``fact``, the share of frames in which it is wrong."""
        return (*self.points, *self.gaps, self.fact)


def quantities(task: Task) -> Quantities:
    """What can be read off a task's frames; ``ValueError``: it has no phases between two places."""
    named = {name for phase in task.phases for name in phase.points}
    if not named or any(task.signals[name].shape != (3,) for name in named):
        raise ValueError(f"task {task.name} has no phases between two places each to probe")
    origin = task.phases[-1].points[1]
    gaps: dict[str, tuple[str, str]] = {}
    needed = {}
    for phase in task.phases:
        names = [name for name in phase.points if name != origin]
        if len(names) == 1:
            needed[phase.name] = names[0]
            continue
        # Short, as ``tool_to_block`` is of ``tool_midpoint`` and ``block_position``.
        name = "_to_".join(point.partition("_")[0] for point in phase.points)
        if gaps.get(name, phase.points) != phase.points:
            name = "_to_".join(phase.points)
        gaps[name], needed[phase.name] = phase.points, name
    ends = {phase.name: phase.ends for phase in task.phases}
    backwards = (name for phase in reversed(task.phases) for name in phase.points)
    points = dict.fromkeys(name for name in backwards if name != origin)
    return Quantities(task.name, ends, origin, tuple(points), gaps, needed)


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


def collect(settings: Settings, episodes: int, per_phase: int) -> Frames:
    """Frames of the first episode of ``episodes`` environments of the settings' seed.

    Every batch runs twice: once blind, to know each episode's phases, and once more to look at
    the steps that were chosen. An image costs more than a step. ``per_phase``: most frames of one
    phase of one episode, spread evenly over it. Errors are as in ``quantities``.
    """
    task = settings.definition
    targets = quantities(task)
    images, moments, numbers = [], [], []
    for simulation in batches(settings, episodes, _BATCH):
        phases = [
            torch.where(step.alive, phase_of(targets, step.moment.signals), -1)
            for step in rollout(simulation, _cast(simulation))
        ]
        chosen = _spread(torch.stack(phases).numpy(), len(targets.phases), per_phase)
        simulation.reseed(settings.seed)
        for step, mask in zip(rollout(simulation, _cast(simulation)), chosen, strict=True):
            ids = torch.from_numpy(np.flatnonzero(mask))
            if len(ids):
                images.append(simulation.images(ids))
                moments.append(step.moment.signals[ids])
                numbers.append(int(simulation.envs[0]) + ids)
    signals: Any = torch.cat(moments)
    places = [getattr(signals, name) for name in targets.points]
    return Frames(
        {name: torch.cat([shown[name] for shown in images]) for name in images[0]},
        columns(task.state, signals),
        1e3 * (torch.stack(places, 1) - getattr(signals, targets.origin)[:, None]).float(),
        getattr(signals, targets.fact),
        phase_of(targets, signals),
        torch.cat(numbers),
    )


def phase_of(targets: Quantities, signals: Signals) -> Tensor:
    """Index of the phase ``(n,)`` int64 of each environment's moment.

    It is the phase after the last fact that holds; but the first phase until its own fact holds.
    A fact in between may be false again: what is put down is no longer high up.
    """
    index = torch.zeros(signals.batch_size, dtype=torch.int64)
    for number, phase in enumerate(targets.phases[:-1], 1):
        index = torch.where(getattr(signals, targets.ends[phase]), number, index)
    return torch.where(getattr(signals, targets.fact), index, 0)


def _cast(simulation: Simulation) -> Controller:
    """The controllers of a batch: environment ``i`` has the one that ``KINDS`` names."""
    settings, first = simulation.settings, int(simulation.envs[0])
    n, expert = settings.num_envs, controller("expert", settings)
    kinds = [KINDS[(first + env) % len(KINDS)] for env in range(n)]
    is_random, perturbed = (
        torch.tensor([k == kind for k in kinds]).unsqueeze(-1) for kind in ("random", "perturbed")
    )
    generator = torch.Generator().manual_seed(settings.seed + first)

    def draw(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    low, high = _NOISE
    amplitude = (low + (high - low) * draw(n, 1)) * perturbed
    drift = torch.zeros(n, settings.episode.action_size, dtype=torch.float64)

    def act(signals: Signals) -> Tensor:
        uniform = 2.0 * draw(*drift.shape) - 1.0
        drift.mul_(NOISE_MEMORY).add_(uniform)
        scripted = expert(signals) + amplitude * drift
        return torch.where(is_random, uniform, scripted.clamp(-1.0, 1.0))

    return act


def _spread(phases: np.ndarray, number: int, most: int) -> np.ndarray:
    """At most ``most`` moments of each phase of each episode, evenly spread; bool as ``phases``."""
    chosen = np.zeros(phases.shape, dtype=bool)
    for env in range(phases.shape[1]):
        for phase in range(number):
            (at,) = np.nonzero(phases[:, env] == phase)
            picks = np.linspace(0, len(at) - 1, min(most, len(at))).round().astype(int)
            chosen[at[picks], env] = True
    return chosen
