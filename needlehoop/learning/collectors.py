"""Collect buffers of steps: for reinforcement, and with an expert's labels for imitation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.modules import IndependentNormal

from needlehoop.envs.controllers import Perturbation, controller
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.job import DaggerConfig
from needlehoop.learning.parallel import ParallelAgent

LABEL = "label"
"""What the expert would have done, among a step's keys."""

LEARNER = "learner"
"""Whether the learner acted, among a step's keys."""


class _Collector:
    """Fills one buffer ``(num_envs, horizon)`` again and again.

    Each image is folded once, into the place where it stays. Nothing is copied at a reset.

    Args:
        env: is begun, or gone on with, at the first buffer.
        horizon: steps of each environment per buffer.
    """

    def __init__(self, env: TorchRLEnv, running: ParallelAgent, horizon: int, workers: Workers):
        self._env, self._running, self._workers = env, running, workers
        self._agent = agent = running.agent
        self._device = next(agent.parameters()).device
        count = env.settings.num_envs
        blank = env.observation_spec.zero()
        prepared = agent.prepare(*(blank[key] for key in agent.in_keys))
        kept = {
            key: torch.zeros(count, horizon, *x.shape[1:], dtype=x.dtype, device=self._device)
            for key, x in zip(agent.seen_keys, prepared, strict=True)
        }
        self._buffer = TensorDict(kept, [count, horizon], device=self._device)
        self._horizon, self._parts = horizon, workers.parts(count)
        self._now: TensorDictBase | None = None

    def _see(self, step: int) -> list[Any]:
        """Keep what the agent sees now; returns it, in the order of its ``seen_keys``."""
        now = self._now = self._env.reset() if self._now is None else self._now
        observed = [now[key] for key in self._agent.in_keys]
        kept: list[Any] = [self._buffer[key][:, step] for key in self._agent.seen_keys]

        def keep(rows: slice) -> None:
            seen = self._agent.prepare(*(x[rows].to(self._device) for x in observed))
            for place, value in zip(kept, seen, strict=True):
                place[rows] = value

        self._workers.map(keep, self._parts)
        return kept

    def _step(self, step: int, acted: dict[str, Tensor]) -> TensorDict:
        """Carry out ``acted["action"]``, and keep all of ``acted`` and, as ``next``, its result."""
        after, self._now = self._env.step_and_reset(acted["action"].cpu())
        rows = TensorDict({**acted, "next": after.exclude("pixels")}, self._env.batch_size)
        if "action" not in self._buffer.keys():  # noqa: SIM118 - of a TensorDict
            room = rows.unsqueeze(1).expand(*self._buffer.batch_size)
            self._buffer.update(room.clone().to(self._device))
        self._buffer[:, step].update_(rows)
        return after


class Collector(_Collector):
    """The agent acts at random, as its policy says; see ``_Collector``."""

    @torch.no_grad()
    def collect(self) -> tuple[TensorDict, TensorDict]:
        """The next buffer, valid until the next call, and what was seen after its cuts.

        A buffer holds what the agent saw (its ``seen_keys``), ``action``, ``action_log_prob``,
        ``scale``, ``state_value`` and, under ``next``, the result, without images. A cut is a
        truncation or the buffer's end. Their observations are in the order of the buffer's rows.
        """
        cuts: dict[int, TensorDictBase] = {}
        for step in range(self._horizon):
            loc, scale, value = self._running.outputs(self._see(step))
            policy = IndependentNormal(loc, scale)
            action = policy.sample()
            log_prob = policy.log_prob(action)
            acted = {"action": action, "action_log_prob": log_prob, "state_value": value}
            after = self._step(step, {**acted, "scale": scale})
            cut = after["truncated"].squeeze(-1) | (step == self._horizon - 1)
            for env in cut.nonzero().flatten().tolist():
                cuts[env * self._horizon + step] = after.select(*self._agent.in_keys)[env].clone()
        seen: Any = torch.stack([cuts[row] for row in sorted(cuts)])
        return self._buffer, seen.to(self._device)

    def state_dict(self) -> dict[str, Any]:
        """What decides the next buffer, beside the agent."""
        return {"env": self._env.snapshot()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self._env.restore(state["env"])


class LabellingCollector(_Collector):
    """The expert or the learner acts, and the expert labels every frame; see ``_Collector``.

    Who acts in an episode is drawn when it begins: the learner, on its mean, or the expert, with
    noise on its actions that it then corrects.

    A resumed run repeats its earlier buffers (``review``): the actions decide all frames, and
    take a thousandth of the room.

    Args:
        seed: decides who acts, and the noise.
    """

    def __init__(
        self,
        env: TorchRLEnv,
        running: ParallelAgent,
        config: DaggerConfig,
        seed: int,
        workers: Workers,
    ):
        super().__init__(env, running, config.horizon, workers)
        self._expert = controller(env.settings.definition.teacher, env.settings)
        count, size = env.settings.num_envs, env.settings.episode.action_size
        self._generator = torch.Generator().manual_seed(seed)
        self._noise = Perturbation(count, size, config.noise, self._generator)
        self._learner = torch.zeros(count, dtype=torch.bool)
        self._actions: list[Tensor] = []

    @torch.no_grad()
    def collect(self, share: float) -> TensorDict:
        """The next buffer, valid until the next call.

        It holds what the agent saw (its ``seen_keys``), ``label``, ``action``, ``learner`` and,
        under ``next``, the result, without images.

        Args:
            share: of the episodes that begin in which the learner acts.
        """
        for step in range(self._horizon):
            seen, label = self._see(step), self._label()
            action = label + self._noise().float()
            if bool(self._learner.any()):
                loc, *_ = self._running.outputs(seen)
                action = torch.where(self._learner.unsqueeze(-1), loc.cpu(), action)
            done = self._try(step, label, action.clamp(-1.0, 1.0))
            drawn = torch.rand(done.shape, generator=self._generator) < share
            self._learner = torch.where(done, drawn, self._learner)
            self._noise.begin(done)
        self._actions.append(self._buffer["action"].cpu().clone())
        return self._buffer

    @torch.no_grad()
    def review(self, actions: Tensor) -> TensorDict:
        """An earlier buffer again, by its actions ``(num_envs, horizon, size)``."""
        self._actions.append(actions)
        for step, action in enumerate(actions.unbind(1)):
            self._see(step)
            self._try(step, self._label(), action)
        return self._buffer

    def _label(self) -> Tensor:
        """What the expert would do now; it reads the signals."""
        return self._expert(self._env.simulation.look().signals).float()

    def _try(self, step: int, label: Tensor, action: Tensor) -> Tensor:
        """Carry out an action; returns which episodes are over ``(num_envs,)``."""
        acted = {LABEL: label, "action": action, LEARNER: self._learner.unsqueeze(-1)}
        return self._step(step, acted)["done"].squeeze(-1)

    def state_dict(self) -> dict[str, Any]:
        """The actions of all buffers so far, and what decides the next."""
        lessons = {
            "flown": torch.stack(self._actions),
            "learner": self._learner,
            "noise": self._noise.snapshot(),
            "generator": self._generator.get_state(),
        }
        return {"lessons": lessons}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state_dict``, whose buffers have been reviewed."""
        lessons = state["lessons"]
        self._learner = lessons["learner"]
        self._noise.restore(lessons["noise"])
        self._generator.set_state(lessons["generator"])
