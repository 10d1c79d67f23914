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

from needlehoop.learning.agent import Agent
from needlehoop.learning.algorithm import Algorithm, Memory, step
from needlehoop.learning.algorithm_config import DaggerConfig
from needlehoop.learning.policy_spec import PolicySpec
from needlehoop.learning.transforms import EXPERT, LABEL, LEARNER

_RAMP = 30
"""Minibatches over which the learning rate rises at the very start."""


class Pupil(TensorDictModuleBase):
    """Acts as the expert does or, in the learner's episodes, as the policy would on average."""

    def __init__(self, agent: Agent):
        super().__init__()
        self.in_keys, self.out_keys = [*agent.seen_keys, EXPERT, LEARNER], ["action"]
        self.trunk, self.head = agent.trunks[0], agent.gaussian
        self._seen = agent.seen_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        action, learner = tensordict[EXPERT], tensordict[LEARNER]
        if bool(learner.any()):
            said = self.head.act(self.trunk(*(tensordict[key] for key in self._seen)))
            action = torch.where(learner, said.clamp(-1.0, 1.0), action)
        return tensordict.set("action", action)


class Dagger(Algorithm):
    """Learns from all frames so far, after each new buffer of them.

    The mean action is fitted by a smooth L1 loss: the few frames in which the expert switches then
    count for less. The deviation is fitted to the error that is left. The policy becomes the
    Gaussian that explains the expert best. The value function does not change.
    """

    config: DaggerConfig

    def __init__(self, agent: Agent, config: DaggerConfig, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        self.policy = Pupil(agent)
        self._adam([*agent.actor.parameters()])
        own = (config.memory, config.minibatch, self.device, self._generator)
        self._memory = Memory(*own)

    @staticmethod
    def agent_of(spec: PolicySpec, dtype: torch.dtype) -> Agent:
        return Agent(spec, dtype)

    def remember(self, buffer: TensorDictBase) -> None:
        self._memory.extend(buffer.select(*self.agent.seen_keys, LABEL).reshape(-1))

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        """As ``Algorithm.update``. Episodes of the expert do not count as ended afterwards."""
        self.remember(buffer)
        totals, rate = Counter[str](), 0.0
        for number in range(self.config.minibatches):
            rate = self._schedule(number)
            frames = self._memory.sample(self.agent.fold, self.config.picture_shift)
            loss, told = self._judge(frames)
            step(self._optimizers["all"], loss)
            totals.update(told)
        self._end_update(buffer)
        buffer["next", "done"] &= buffer[LEARNER]
        return {
            **{name: float(value) / self.config.minibatches for name, value in totals.items()},
            "frames": float(len(self._memory)),
            "learning_rate": rate,
            "share": float(buffer[LEARNER].float().mean()),
        }

    def _judge(self, frames: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss, and what it reports."""
        label: Any = frames[LABEL]
        actor = self.agent.actor
        loc, scale = actor.head(actor.trunk(*(frames[key] for key in self.agent.seen_keys)))
        error = functional.smooth_l1_loss(loc, label, reduction="none", beta=self.config.bend)
        weights = torch.ones_like(label[0])
        weights[-1] = self.config.jaw
        imitation = (error * weights).mean()
        left = (loc.detach() - label) ** 2
        likelihood = (scale.log() + left / (2 * scale**2)).mean()
        told = {
            "loss_imitation": imitation,
            "error": (loc - label).abs().mean(),
            "error_jaw": (loc - label)[:, -1].abs().mean(),
            "sigma": scale.mean(),
        }
        return imitation + likelihood, {name: one.detach() for name, one in told.items()}

    def _schedule(self, number: int) -> float:
        """Set the learning rate for a minibatch of this buffer; returns it."""
        done = self.done_updates * self.config.minibatches + number
        share = done / (self.updates * self.config.minibatches)
        rate = self.config.learning_rate * (1 + math.cos(math.pi * share)) / 2
        rate *= min(1.0, (done + 1) / _RAMP)
        self._optimizers["all"].param_groups[0]["lr"] = rate
        return rate
