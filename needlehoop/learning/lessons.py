"""Lessons: expert and learner take turns at flying, and the expert says what it would have done."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from needlehoop.envs.controllers import controller
from needlehoop.envs.perturbation import Perturbation
from needlehoop.envs.torchrl_env import NeedleHoopEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.dagger import LABEL
from needlehoop.learning.hyperparameters import DaggerConfig
from needlehoop.learning.parallel import ParallelAgent

TEACHER = "smooth"
"""The scripted controller that is imitated."""

LEARNER = "learner"
"""Whether the learner flew, among a step's keys."""


class Lessons:
    """Fills one buffer ``(num_envs, horizon)`` after the other.

    Who flies an episode is drawn when it begins: the learner, on its mean, or the expert, led
    astray by noise that it corrects. The expert sees signals and labels every frame.

    A run goes on by flying its lessons again (``review``): the actions decide all frames, and
    take a thousandth of their room.

    Args:
        env: not begun.
        running: the learner.
        config: hyperparameters.
        seed: decides who flies, and the noise.
        workers: that fold images.
    """

    def __init__(
        self,
        env: NeedleHoopEnv,
        running: ParallelAgent,
        config: DaggerConfig,
        seed: int,
        workers: Workers,
    ):
        self._env, self._running, self._workers = env, running, workers
        self._horizon, self._agent = config.horizon, running.agent
        self._device = next(self._agent.parameters()).device
        self._expert = controller(TEACHER, env.settings)
        count, size = env.settings.num_envs, env.settings.episode.action_size
        self._generator = torch.Generator().manual_seed(seed)
        self._noise = Perturbation(count, size, config.noise, self._generator)
        self._learner = torch.zeros(count, dtype=torch.bool)
        self._flown: list[Tensor] = []
        self._parts = workers.parts(count)
        self._now: TensorDictBase | None = None

    @torch.no_grad()
    def collect(self, share: float) -> TensorDict:
        """The next buffer.

        It holds what the agent saw (its ``seen_keys``), ``label``, ``action``, ``learner`` and,
        under ``next``, what came of it, but no images.

        Args:
            share: of the episodes that begin which the learner flies.
        """
        steps = []
        for _ in range(self._horizon):
            seen, label = self._look()
            action = self._choose(seen, label).clamp(-1.0, 1.0)
            steps.append(self._step(seen, label, action))
            self._take_turns(steps[-1]["next", "done"].squeeze(-1).cpu(), share)
        self._flown.append(torch.stack([step["action"].cpu() for step in steps], 1))
        return _stacked(steps)

    @torch.no_grad()
    def review(self, flown: Tensor) -> TensorDict:
        """The buffer of a lesson flown before, by its actions ``(num_envs, horizon, size)``."""
        self._flown.append(flown)
        return _stacked([self._step(*self._look(), action) for action in flown.unbind(1)])

    def _look(self) -> tuple[list[Tensor], Tensor]:
        """What the agent sees now, in the order of its ``seen_keys``; and the expert's action."""
        now = self._now = self._env.reset() if self._now is None else self._now
        observed: list[Any] = [now[key] for key in self._agent.in_keys]

        def prepare(rows: slice) -> list[Tensor]:
            return self._agent.prepare(*(x[rows].to(self._device) for x in observed))

        parts = self._workers.map(prepare, self._parts)
        label = self._expert(self._env.simulation.look().signals)
        return [torch.cat(part) for part in zip(*parts, strict=True)], label.float()

    def _choose(self, seen: list[Tensor], label: Tensor) -> Tensor:
        led_astray = label + self._noise().float()
        if not bool(self._learner.any()):
            return led_astray
        loc, *_ = self._running.outputs(seen)
        return torch.where(self._learner.unsqueeze(-1), loc.cpu(), led_astray)

    def _step(self, seen: list[Tensor], label: Tensor, action: Tensor) -> TensorDict:
        after, self._now = self._env.step_and_reset(action)
        kept: dict[Any, Any] = dict(zip(self._agent.seen_keys, seen, strict=True))
        told = {LABEL: label, "action": action, LEARNER: self._learner.unsqueeze(-1)}
        step = TensorDict({**told, "next": after.exclude("pixels")}, self._env.batch_size)
        step = step.to(self._device)
        for key, value in kept.items():
            step[key] = value
        return step

    def _take_turns(self, done: Tensor, share: float) -> None:
        """Draw who flies the episodes that begin."""
        drawn = torch.rand(done.shape, generator=self._generator) < share
        self._learner = torch.where(done, drawn, self._learner)
        self._noise.begin(done)

    def state_dict(self) -> dict[str, Any]:
        """All lessons so far, and what decides the next."""
        return {
            "flown": torch.stack(self._flown) if self._flown else self.blank(0),
            "learner": self._learner,
            "noise": self._noise.snapshot(),
            "generator": self._generator.get_state(),
        }

    def blank(self, count: int) -> Tensor:
        """Actions of so many lessons, none of them flown."""
        settings = self._env.settings
        return torch.zeros(count, settings.num_envs, self._horizon, settings.episode.action_size)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict``, whose lessons have been reviewed."""
        self._learner = state["learner"]
        self._noise.restore(state["noise"])
        self._generator.set_state(state["generator"])


def _stacked(steps: list[Any]) -> Any:
    return torch.stack(steps, 1)
