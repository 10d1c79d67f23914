"""Collects buffers: the agent acts, the environment answers."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.modules import IndependentNormal

from needlehoop.envs.torchrl_env import NeedleHoopEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.parallel import ParallelAgent


class Collector:
    """Fills one buffer ``(num_envs, horizon)`` again and again.

    Images are folded to where they stay, each once, and nothing is copied at a reset.

    Args:
        env: is begun, or gone on with, at the first buffer.
        running: acts, at random.
        horizon: steps of each environment per buffer.
        workers: that fold images.
    """

    def __init__(self, env: NeedleHoopEnv, running: ParallelAgent, horizon: int, workers: Workers):
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
        self._parts = workers.parts(count)
        self._now: TensorDictBase | None = None

    @torch.no_grad()
    def collect(self) -> tuple[TensorDict, TensorDict]:
        """The next buffer, and what was seen after its cuts; the former until the next call.

        A buffer holds what the agent saw (its ``seen_keys``), ``action``, ``action_log_prob``,
        ``scale``, ``state_value`` and, under ``next``, what came of it, but no images. A cut is
        a time-out or the buffer's end. Their observations are in the order of the buffer's rows.
        """
        if self._now is None:
            self._now = self._env.reset()
        horizon = self._buffer.shape[1]
        cuts: dict[int, TensorDictBase] = {}
        for step in range(horizon):
            acted = self._act(step, self._now)
            after, self._now = self._env.step_and_reset(acted["action"].cpu())
            self._write(step, acted.set("next", after.exclude("pixels")))
            cut = after["truncated"].squeeze(-1) | (step == horizon - 1)
            for env in cut.nonzero().flatten().tolist():
                cuts[env * horizon + step] = after.select(*self._agent.in_keys)[env].clone()
        seen: Any = torch.stack([cuts[row] for row in sorted(cuts)])
        return self._buffer, seen.to(self._device)

    def _act(self, step: int, now: TensorDictBase) -> TensorDict:
        """Keep what is seen, and choose actions."""
        observed = [now[key] for key in self._agent.in_keys]
        kept: list[Any] = [self._buffer[key][:, step] for key in self._agent.seen_keys]

        def keep(rows: slice) -> None:
            seen = self._agent.prepare(*(x[rows].to(self._device) for x in observed))
            for place, value in zip(kept, seen, strict=True):
                place[rows] = value

        self._workers.map(keep, self._parts)
        loc, scale, value = self._running.outputs(kept)
        policy = IndependentNormal(loc, scale)
        action = policy.sample()
        log_prob = policy.log_prob(action)
        acted = {"action": action, "action_log_prob": log_prob, "state_value": value}
        return TensorDict({**acted, "scale": scale}, now.batch_size)

    def _write(self, step: int, acted: TensorDictBase) -> None:
        if "action" not in self._buffer.keys():  # noqa: SIM118 - of a TensorDict
            room = acted.unsqueeze(1).expand(*self._buffer.batch_size)
            self._buffer.update(room.clone().to(self._device))
        self._buffer[:, step].update_(acted)
