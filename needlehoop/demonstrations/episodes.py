"""Whole episodes as arrays: who demonstrates, and what was seen, done and paid at each step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import torch
from torch import Tensor

from needlehoop.envs.controllers import Perturbation, controller
from needlehoop.envs.observer import read
from needlehoop.envs.rollout import Controller, MakeController, Step, batches
from needlehoop.envs.settings import Settings
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task

PERTURBED = "perturbed"
"""The task's teacher, with noise on its actions that it then corrects."""

_CHEAT = "cheat"
"""A controller that shows what not to do."""

_BATCH = 40
"""Episodes side by side."""

_STRONGEST = 0.8
"""Strongest noise of a perturbed episode, in units of the action; a teacher copes with it."""


@dataclass(frozen=True)
class About:
    """What a dataset says of itself."""

    demonstrator: str
    settings: Settings
    provenance: Mapping[str, Any]
    """Commit, versions, machine, time."""

    @property
    def rate(self) -> float:
        """Steps per second of simulated time."""
        return 1.0 / self.settings.period


@dataclass(frozen=True)
class Demonstration:
    """One episode of ``t`` steps; observations have a row more: the one after the last step.

    ``images`` ``(t + 1, h, w, c)`` uint8 by camera; ``vectors`` ``(t + 1, k)`` float32:
    ``proprio`` always, ``signals`` and ``told`` where the settings ask for them; ``actions``
    ``(t, k)`` float32, as they were carried out; ``rewards`` ``(t,)`` float32. It ends by success
    (``episode.success``) or by its time limit.
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
    """A scripted demonstrator of a task: one of its controllers, or ``PERTURBED``.

    Raises:
        ValueError: an unknown name.
    """
    others = (one for one in task.controllers if one not in (task.teacher, _CHEAT))
    valid = (task.teacher, *others, PERTURBED)
    if name not in valid:
        raise ValueError(
            f"demonstrator: {name!r} is unknown; choose from {', '.join(valid)},"
            " or give a run's folder"
        )
    if name == PERTURBED:
        return _perturbed()
    return lambda settings, *_: controller(name, settings)


def _perturbed() -> MakeController:
    batches = count()

    def pilot(settings: Settings, *_: object) -> Controller:
        # A batch's noise is drawn for a full one: an episode is the same in a smaller.
        generator = torch.Generator().manual_seed(settings.seed + (next(batches) << 32))
        noise = Perturbation(_BATCH, settings.episode.action_size, _STRONGEST, generator)
        expert = controller(settings.definition.teacher, settings)

        def act(signals: Signals) -> Tensor:
            return expert(signals) + noise()[: len(signals)]

        return act

    return pilot


def demonstrate(settings: Settings, make: MakeController, episodes: int) -> Iterator[Demonstration]:
    """The first episodes of ``episodes`` environments of the settings' seed, in order.

    Args:
        settings: environment; ``num_envs`` is ignored.
        make: who demonstrates.
        episodes: how many; episode ``i`` is the same however many there are.

    Raises:
        ValueError: fewer than one episode, no camera, or stacked frames.
    """
    if not settings.cams:
        raise ValueError("cams: demonstrations need at least one camera, such as cams=dep_front")
    if settings.obs.frame_stack > 1:
        raise ValueError(
            f"obs.frame_stack: {settings.obs.frame_stack}; demonstrations keep each frame once"
        )

    def carried_out(*given: Any) -> Controller:
        act = make(*given)
        return lambda signals: act(signals).clamp(-1.0, 1.0)

    for batch in batches(settings, episodes, _BATCH):
        logs = [_Log(settings.cams) for _ in range(batch.settings.num_envs)]
        for step in batch.rollout(carried_out):
            seen = _seen(settings, step)
            for env in step.alive.nonzero().flatten().tolist():
                logs[env].add(seen, step, env)
        for log in logs:
            yield log.demonstration()


def _seen(settings: Settings, step: Step) -> dict[str, np.ndarray]:
    """Images ``(n, h, w, c)`` and vectors ``(n, k)`` by name."""
    vectors = read(settings.definition, replace(settings.obs, proprio=True), step.signals)
    return {
        **{name: image.permute(0, 2, 3, 1).numpy() for name, image in step.images().items()},
        **{name: rows.numpy() for name, rows in vectors.items()},
    }


class _Log:
    """One episode so far.

    Args:
        cameras: names of the images among what was seen.
    """

    def __init__(self, cameras: tuple[str, ...]):
        self._cameras = cameras
        self._seen: list[dict[str, np.ndarray]] = []
        self._actions: list[np.ndarray] = []
        self._rewards: list[float] = []
        self._ended: dict[str, bool] = {}

    def add(self, seen: dict[str, np.ndarray], step: Step, env: int) -> None:
        """One environment's part of a step."""
        # Copies: the images are the engine's buffers, used again for the next step.
        self._seen.append({name: rows[env].copy() for name, rows in seen.items()})
        if step.action is None:
            return
        moment = step.moment
        self._actions.append(step.action[env].to(torch.float32).numpy().copy())
        self._rewards.append(float(moment.reward[env]))
        self._ended = {
            "success": bool(moment.facts["success"][env]),
            "terminated": bool(moment.terminated[env]),
        }

    def demonstration(self) -> Demonstration:
        """The whole episode."""
        seen = {name: np.stack([row[name] for row in self._seen]) for name in self._seen[0]}
        return Demonstration(
            images={name: seen[name] for name in self._cameras},
            vectors={name: rows for name, rows in seen.items() if name not in self._cameras},
            actions=np.stack(self._actions),
            rewards=np.array(self._rewards, dtype=np.float32),
            **self._ended,
        )
