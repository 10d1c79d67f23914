"""Imitation (DAgger): fits the policy to what an expert would have done."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.collectors import LABEL, LEARNER
from needlehoop.learning.job import DaggerConfig
from needlehoop.learning.trainer import Trainer

_RAMP = 30
"""Minibatches over which the learning rate rises at the very start."""


class Dagger(Trainer):
    """Learns from all frames so far, after each new buffer of them.

    The mean action is fitted by a smooth L1 loss: the few frames in which the expert switches then
    count for less. The deviation is fitted to the error that is left. The policy becomes the
    Gaussian that explains the expert best. The value function does not change.
    """

    def __init__(
        self, agent: Agent, config: DaggerConfig, updates: int, seed: int, workers: Workers
    ):
        super().__init__(agent, config.shards, updates, seed, workers)
        self.config = config
        device = next(agent.parameters()).device
        self._frames = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.memory, device=device)
        )

    @property
    def share(self) -> float:
        """Of the episodes that begin now, those in which the learner acts."""
        return min(1.0, self.done_updates * (1.0 / (self.config.handover * self.updates)))

    def remember(self, buffer: TensorDictBase) -> None:
        """Take frames ``(num_envs, horizon)`` into memory: what was seen, and labels."""
        self._frames.extend(buffer.select(*self.agent.seen_keys, LABEL).reshape(-1))

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        """Learn, with a new buffer's frames; returns means over the minibatches.

        Episodes of the expert do not count as ended in the buffer afterwards.
        """
        self.remember(buffer)
        share = self.share
        frames: Any = self._frames[:]
        seen = [frames[key] for key in self.agent.seen_keys]
        totals, rate = Counter[str](), 0.0
        for number in range(self.config.minibatches):
            rate = self._schedule(number)
            rows = torch.randint(len(frames), (self.config.minibatch,), generator=self._generator)
            rows = rows.to(frames.device)
            labels = frames[LABEL].index_select(0, rows)
            slopes, told = self._judge(self._forward(seen, rows), labels)
            self.running.backward(slopes)
            self._optimizer.step(self.running.write)
            totals.update(told)
        self._end_update(buffer)
        buffer["next", "done"] &= buffer[LEARNER]
        return {
            **{name: value / self.config.minibatches for name, value in totals.items()},
            "frames": float(len(frames)),
            "learning_rate": rate,
            "share": share,
        }

    def _forward(self, seen: list[Tensor], rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What the agent says of a minibatch, whose images are moved at random first."""
        most, count = self.config.picture_shift, len(rows)
        if not most:
            return self.running.forward(seen, rows)
        chosen = [x.index_select(0, rows) for x in seen]
        part = -(-count // self.config.shards)
        for i, key in enumerate(self.agent.seen_keys):
            if key[0] == "folded":
                ways = torch.randint(-most, most + 1, (2, count), generator=self._generator)
                down, right = (way.to(rows.device).split(part) for way in ways)
                moved = self._workers.map(self.agent.fold.moved, chosen[i].split(part), down, right)
                chosen[i] = torch.cat(moved)
        return self.running.forward(chosen, torch.arange(count, device=rows.device))

    def _judge(
        self, said: Sequence[Tensor], label: Tensor
    ) -> tuple[tuple[Tensor, ...], dict[str, float]]:
        """The loss's gradient by each of the agent's outputs, and what it reports."""
        loc, scale, value = (output.requires_grad_() for output in said)
        error = functional.smooth_l1_loss(loc, label, reduction="none", beta=self.config.bend)
        weights = torch.ones_like(label[0])
        weights[-1] = self.config.jaw
        imitation = (error * weights).mean()
        left = (loc.detach() - label) ** 2
        likelihood = (scale.log() + left / (2 * scale**2)).mean()
        # The value takes no part; its gradient is nothing.
        total = imitation + likelihood + 0.0 * value.sum()
        told = {
            "loss_imitation": float(imitation.detach()),
            "error": float((loc - label).abs().mean().detach()),
            "error_jaw": float((loc - label)[:, -1].abs().mean().detach()),
            "sigma": float(scale.mean().detach()),
        }
        return torch.autograd.grad(total, (loc, scale, value)), told

    def _schedule(self, number: int) -> float:
        """Set the learning rate for a minibatch of this buffer; returns it."""
        done = self.done_updates * self.config.minibatches + number
        share = done / (self.updates * self.config.minibatches)
        rate = self.config.learning_rate * (1 + math.cos(math.pi * share)) / 2
        rate *= min(1.0, (done + 1) / _RAMP)
        self._optimizer.set_rate(rate)
        return rate
