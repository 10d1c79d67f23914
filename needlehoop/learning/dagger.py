"""Imitation: the policy is fitted to what an expert would have done."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.hyperparameters import DaggerConfig
from needlehoop.learning.normalizer import Normalizer
from needlehoop.learning.optimizer import Optimizer
from needlehoop.learning.parallel import ParallelAgent

LABEL = "label"
"""What the expert would have done, among a frame's keys."""

_RAMP = 30
"""Minibatches over which the learning rate rises at the very start."""


class Dagger:
    """Learns from all frames so far, after each new buffer of them.

    The mean action is fitted by a smooth L1 loss, which a few frames where the expert switches
    do not rule; the deviation to what is left of the error, so that the policy is the Gaussian
    that explains the expert best. The value function is left as it is.

    Args:
        agent: updated in place. ``running`` is a copy to fly with.
        config: hyperparameters.
        updates: buffers until the schedule ends.
        seed: decides the minibatches.
        workers: to share the work; the result is the same with any number.
    """

    def __init__(
        self, agent: Agent, config: DaggerConfig, updates: int, seed: int, workers: Workers
    ):
        self.agent, self.config, self.updates = agent, config, updates
        self.done_updates = 0
        device = next(agent.parameters()).device
        # A GPU needs no parts.
        shards = config.shards if device.type == "cpu" else 1
        self.running = ParallelAgent(agent.computing(), shards, workers)
        copies = list(self.running.agent.parameters())
        self._optimizer = Optimizer(list(agent.parameters()), copies, workers)
        self._normalizers = {
            path.rpartition(".")[2]: module
            for path, module in agent.named_modules()
            if isinstance(module, Normalizer)
        }
        self._frames = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.memory, device=device)
        )
        self._generator = torch.Generator().manual_seed(seed)

    def remember(self, buffer: TensorDictBase) -> None:
        """Take frames ``(num_envs, horizon)`` into memory: what was seen, and labels."""
        self._frames.extend(buffer.select(*self.agent.seen_keys, LABEL).reshape(-1))

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        """Learn, with a new buffer's frames; returns means over the minibatches."""
        self.remember(buffer)
        frames: Any = self._frames[:]
        seen = [frames[key] for key in self.agent.seen_keys]
        totals: defaultdict[str, float] = defaultdict(float)
        rate = 0.0
        for number in range(self.config.minibatches):
            rate = self._schedule(number)
            rows = torch.randint(len(frames), (self.config.minibatch,), generator=self._generator)
            rows = rows.to(frames.device)
            for name, value in self._descend(seen, frames[LABEL], rows).items():
                totals[name] += value
        for name, normalizer in self._normalizers.items():
            normalizer.learn(buffer[name])
        self.running.agent.follow(self.agent)
        self.done_updates += 1
        return {
            **{name: value / self.config.minibatches for name, value in totals.items()},
            "frames": float(len(frames)),
            "learning_rate": rate,
        }

    def _descend(self, seen: list[Tensor], labels: Tensor, rows: Tensor) -> dict[str, float]:
        """One step of the optimiser on a minibatch; returns what the loss reports."""
        slopes, told = self._judge(self.running.forward(seen, rows), labels.index_select(0, rows))
        self.running.backward(slopes)
        self._optimizer.step(self.running.write)
        return told

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

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides the next update, but for the frames in memory."""
        return {
            "agent": self.agent.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "generator": self._generator.get_state(),
            "done_updates": self.done_updates,
        }

    def moved_state(self) -> dict[str, Any]:
        """What ``state_dict`` is like after an update, for those who check one that they read."""
        return {**self.state_dict(), "optimizer": self._optimizer.moved_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict``; the frames are to be remembered again."""
        self.agent.load_state_dict(state["agent"])
        self.running.agent.follow(self.agent)
        self._optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self.done_updates = state["done_updates"]
