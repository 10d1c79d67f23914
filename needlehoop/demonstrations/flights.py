"""Whole episodes as arrays: what was seen, done and paid, step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.images import Imager
from needlehoop.envs.observer import read
from needlehoop.envs.rollout import Controller
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Moment, Simulation

BATCH = 40
"""Episodes flown side by side."""

Pilot = Callable[[Settings, Simulation, Imager], Controller]
"""Makes the controller of a batch from its settings, simulation and imager."""


@dataclass(frozen=True)
class Flight:
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


def fly(settings: Settings, pilot: Pilot, episodes: int) -> Iterator[Flight]:
    """The first episodes of ``episodes`` environments of the settings' seed, in order.

    Args:
        settings: environment; ``num_envs`` is ignored.
        pilot: who flies.
        episodes: how many; episode ``i`` is the same however many there are.

    Raises:
        ValueError: fewer than one episode, no camera, or stacked frames.
    """
    if episodes < 1:
        raise ValueError(f"episodes: {episodes} must be at least 1")
    if not settings.cams:
        raise ValueError("cams: demonstrations need at least one camera, such as cams=dep_front")
    if settings.obs.frame_stack > 1:
        raise ValueError(
            f"obs.frame_stack: {settings.obs.frame_stack}; demonstrations keep each frame once"
        )
    for first in range(0, episodes, BATCH):
        chunk = replace(settings, num_envs=min(BATCH, episodes - first))
        simulation, imager = build(chunk, first_env=first)
        yield from _batch(chunk, simulation, imager, pilot(chunk, simulation, imager))


def _batch(
    settings: Settings, simulation: Simulation, imager: Imager, controller: Controller
) -> Iterator[Flight]:
    """One episode of every environment of a simulation."""
    n = simulation.num_envs
    logs = [_Log() for _ in range(n)]
    moment = simulation.reset()
    seen = _look(settings, simulation, imager, moment)
    alive = list(range(n))
    for env in alive:
        logs[env].begin({name: rows[env] for name, rows in seen.items()})
    while alive:
        action = controller(moment.signals).clamp(-1.0, 1.0)
        moment = simulation.step(action)
        seen = _look(settings, simulation, imager, moment)
        for env in alive:
            logs[env].add({name: rows[env] for name, rows in seen.items()}, action, moment, env)
        over = moment.terminated | moment.truncated
        alive = [env for env in alive if not bool(over[env])]
    for log in logs:
        yield log.flight(settings.cams)


def _look(
    settings: Settings, simulation: Simulation, imager: Imager, moment: Moment
) -> dict[str, np.ndarray]:
    """Images ``(n, h, w, c)`` and vectors ``(n, k)`` by name."""
    images = imager(simulation.engine.render())
    seen = {name: image.permute(0, 2, 3, 1).numpy() for name, image in images.items()}
    vectors = read(replace(settings.obs, proprio=True), moment.signals)
    return {**seen, **{name: rows.numpy() for name, rows in vectors.items()}}


class _Log:
    """An episode under way."""

    def __init__(self) -> None:
        self._seen: list[dict[str, np.ndarray]] = []
        self._actions: list[np.ndarray] = []
        self._rewards: list[float] = []
        self._last: dict[str, bool] = {}

    def begin(self, seen: dict[str, np.ndarray]) -> None:
        # Copies: the images are the engine's buffers, used again for the next step.
        self._seen.append({name: row.copy() for name, row in seen.items()})

    def add(self, seen: dict[str, np.ndarray], action: Tensor, moment: Moment, env: int) -> None:
        self.begin(seen)
        self._actions.append(action[env].to(torch.float32).numpy().copy())
        self._rewards.append(float(moment.reward[env]))
        self._last = {
            "success": bool(moment.success[env]),
            "terminated": bool(moment.terminated[env]),
        }

    def flight(self, cameras: tuple[str, ...]) -> Flight:
        seen = {name: np.stack([row[name] for row in self._seen]) for name in self._seen[0]}
        return Flight(
            images={name: seen[name] for name in cameras},
            vectors={name: rows for name, rows in seen.items() if name not in cameras},
            actions=np.stack(self._actions),
            rewards=np.array(self._rewards, dtype=np.float32),
            **self._last,
        )
