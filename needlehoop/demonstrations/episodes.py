"""Whole episodes as arrays, of whoever demonstrates, and the folder that they are written into."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from needlehoop.config.strict import check_names
from needlehoop.envs.controllers import (
    Controller,
    MakeController,
    Perturbation,
    Step,
    batches,
    by_name,
    controller,
    rollout,
)
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation, read
from needlehoop.tasks.contract import Task

PERTURBED = "perturbed"
"""The task's teacher, with noise on its actions that it then corrects."""

_BATCH = 40

_STRONGEST = 0.8
"""Strongest noise of a perturbed episode, in units of the action; a teacher copes with it."""


@dataclass(frozen=True)
class Demonstration:
    """One episode of ``t`` steps; observations have a row more: the one after the last step.

    ``images`` ``(t + 1, h, w, c)`` uint8 by camera; ``vectors`` ``(t + 1, k)`` float32:
    ``proprio`` always, ``signals`` and ``privileged_facts`` where the settings ask for them;
    ``actions`` ``(t, k)`` float32, as they were carried out; ``rewards`` ``(t,)`` float32. It ends
    by success (``episode.success``) or by its time limit.
    """

    images: dict[str, np.ndarray]
    vectors: dict[str, np.ndarray]
    actions: np.ndarray
    rewards: np.ndarray
    success: bool
    terminated: bool

    def __len__(self) -> int:
        return len(self.actions)


def scripted(name: str, task: Task) -> MakeController:
    """A task's controller by its name, or ``PERTURBED``; ``ValueError`` for an unknown one."""
    # Nobody learns from a cheat.
    scripts = (script for script in task.controllers if script not in (task.teacher, "cheat"))
    valid = (task.teacher, *scripts, PERTURBED)
    check_names("demonstrator (or a run's folder)", [name], valid)
    if name != PERTURBED:
        return by_name(name)
    numbers = count()

    def pilot(simulation: Simulation) -> Controller:
        settings = simulation.settings
        # Noise is drawn for a full batch: an episode is the same in a smaller one.
        generator = torch.Generator().manual_seed(settings.seed + (next(numbers) << 32))
        noise = Perturbation(_BATCH, settings.episode.action_size, _STRONGEST, generator)
        expert = controller(settings.definition.teacher, settings)
        here = simulation.device
        return lambda signals: expert(signals) + noise()[: len(signals)].to(here)

    return pilot


def demonstrate(settings: Settings, make: MakeController, episodes: int) -> Iterator[Demonstration]:
    """The first episodes of ``episodes`` environments of the settings' seed, in order.

    ``num_envs`` is ignored. Episode ``i`` is the same however many there are. Raises
    ``ValueError`` without a camera, or for stacked frames.
    """
    if not settings.cams:
        raise ValueError("cams: demonstrations need at least one camera, such as cams=dep_front")
    if settings.obs.frame_stack > 1:
        raise ValueError(
            f"obs.frame_stack: {settings.obs.frame_stack}; demonstrations keep each frame once"
        )
    for simulation in batches(settings, episodes, _BATCH):
        act = make(simulation)
        steps = rollout(simulation, lambda signals, act=act: act(signals).clamp(-1.0, 1.0))
        rows = [_row(simulation, step) for step in steps]
        for env in range(simulation.num_envs):
            yield _episode(rows, env)


def _row(simulation: Simulation, step: Step) -> TensorDict:
    """What was seen, done and paid at a step ``(n,)``; images ``(n, h, w, c)``; no action: zero."""
    settings, moment, action = simulation.settings, step.moment, step.action
    shape, obs = (len(step.alive), settings.episode.action_size), settings.obs
    row = {
        "images": {name: image.permute(0, 2, 3, 1) for name, image in simulation.images().items()},
        "vectors": read(settings.definition, replace(obs, proprio=True), moment.signals),
        "action": torch.zeros(shape, device=simulation.device)
        if action is None
        else action.float(),
        "reward": moment.reward.float(),
        "alive": step.alive,
        "success": moment.facts["success"],
        "terminated": moment.terminated,
    }
    # A copy: some are buffers, used again for the next step.
    return TensorDict(row, shape[:1]).to("cpu").clone()


def _episode(rows: list[TensorDict], env: int) -> Demonstration:
    """One environment's episode, from the steps of a batch."""
    steps: Any = torch.stack([row[env] for row in rows if bool(row["alive"][env])])
    return Demonstration(
        images={name: frames.numpy() for name, frames in steps["images"].items()},
        vectors={name: values.numpy() for name, values in steps["vectors"].items()},
        actions=steps["action"][1:].numpy(),
        rewards=steps["reward"][1:].numpy(),
        success=bool(steps["success"][-1]),
        terminated=bool(steps["terminated"][-1]),
    )
