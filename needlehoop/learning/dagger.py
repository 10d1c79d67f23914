"""Imitation (DAgger): fits the policy to what an expert would have done."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn import functional

from needlehoop.learning.agent import ValueAgent
from needlehoop.learning.algorithm import Algorithm, Memory, step
from needlehoop.learning.algorithm_config import DaggerConfig
from needlehoop.learning.transforms import EXPERT, LABEL, LEARNER

_RAMP = 30
"""Minibatches over which the learning rate rises at the very start."""


class Pupil(TensorDictModuleBase):
    """Acts as the expert does or, in the learner's episodes, as the policy would on average."""

    def __init__(self, agent: ValueAgent):
        super().__init__()
        self.in_keys, self.out_keys = [*agent.seen_keys, EXPERT, LEARNER], ["action"]
        self.trunk, self.head = agent.trunk, agent.gaussian
        self._seen = agent.seen_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        action, learner = tensordict[EXPERT], tensordict[LEARNER]
        if bool(learner.any()):
            said = self.head.act(self.trunk(*(tensordict[key] for key in self._seen)))
            action = torch.where(learner, said.clamp(-1.0, 1.0), action)
        return tensordict.set("action", action)


class Dagger(Algorithm):
    """Learns from all frames so far, after each new buffer of them.

    The mean action is fitted by a smooth L1 loss, in which the few frames where the expert
    switches count for less. The deviation is fitted to the error that is left. The value function
    does not change.
    """

    agent_class = ValueAgent
    config: DaggerConfig

    def __init__(self, agent: ValueAgent, config: DaggerConfig, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        self.policy = Pupil(agent)
        self._actor = agent.actor
        self._adam([*self._actor.parameters()])
        self._memory = Memory(config.memory, config.minibatch, self.device, self._generator)

    def remember(self, buffer: TensorDictBase) -> None:
        self._memory.extend(buffer.select(*self.agent.seen_keys, LABEL).reshape(-1))

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        """As ``Algorithm.update``. Episodes of the expert do not count as ended afterwards."""
        self.remember(buffer)
        totals, rate = Counter[str](), 0.0
        for number in range(self.config.minibatches):
            rate = self._schedule(number)
            frames = self._memory.sample(self.agent.fold, self.config.picture_shift)
            loss, reported = self._judge(frames)
            step(self._optimizers["all"], loss)
            totals.update(reported)
        self._end_update(buffer)
        buffer["next", "done"] &= buffer[LEARNER]
        return {
            **{name: float(value) / self.config.minibatches for name, value in totals.items()},
            "frames": float(len(self._memory)),
            "learning_rate": rate,
            "share": float(buffer[LEARNER].float().mean()),
        }

    def _judge(self, frames: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss, and what is reported of it."""
        label: Any = frames[LABEL]
        actor = self._actor
        loc, scale = actor.head(actor.trunk(*(frames[key] for key in self.agent.seen_keys)))
        error = functional.smooth_l1_loss(loc, label, reduction="none", beta=self.config.bend)
        weights = torch.ones_like(label[0])
        weights[-1] = self.config.jaw
        imitation = (error * weights).mean()
        left = (loc.detach() - label) ** 2
        likelihood = (scale.log() + left / (2 * scale**2)).mean()
        reported = {
            "loss_imitation": imitation,
            "error": (loc - label).abs().mean(),
            "error_jaw": (loc - label)[:, -1].abs().mean(),
            "sigma": scale.mean(),
        }
        return imitation + likelihood, {name: one.detach() for name, one in reported.items()}

    def _schedule(self, number: int) -> float:
        """Set the learning rate for a minibatch of this buffer; returns it."""
        done = self.done_updates * self.config.minibatches + number
        share = done / (self.updates * self.config.minibatches)
        rate = self.config.learning_rate * (1 + math.cos(math.pi * share)) / 2
        rate *= min(1.0, (done + 1) / _RAMP)
        self._optimizers["all"].param_groups[0]["lr"] = rate
        return rate
