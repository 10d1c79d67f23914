"""Imitation (DAgger): fits the policy to what an expert would have done."""

from __future__ import annotations

import math
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn import functional

from needlehoop.learning.algorithm import MemoryAlgorithm, step
from needlehoop.learning.algorithm_config import DaggerConfig
from needlehoop.learning.networks import ValueAgent
from needlehoop.learning.transforms import EXPERT, LABEL, LEARNER


class Pupil(TensorDictModuleBase):
    """Acts as the expert does or, in the learner's episodes, as the policy would on average."""

    def __init__(self, agent: ValueAgent):
        super().__init__()
        self.in_keys, self.out_keys = [*agent.seen_keys, EXPERT, LEARNER], ["action"]
        self.trunk, self.head = agent.actor.trunk, agent.actor.head
        self._seen = agent.seen_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        action, learner = tensordict[EXPERT], tensordict[LEARNER]
        if bool(learner.any()):
            prediction = self.head.act(self.trunk(*(tensordict[key] for key in self._seen)))
            action = torch.where(learner, prediction.clamp(-1.0, 1.0), action)
        return tensordict.set("action", action)


class Dagger(MemoryAlgorithm):
    """Fits the policy to the expert's actions in all frames so far.

    The mean action is fitted by a smooth L1 loss, in which the few frames where the expert
    switches count for less. The deviation is fitted to the error that is left. The value function
    does not change.
    """

    agent_class = ValueAgent
    config: DaggerConfig

    def __init__(self, agent: ValueAgent, config: DaggerConfig, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        self.policy, self._actor = Pupil(agent), agent.actor
        self._adam([*self._actor.parameters()])

    def _kept(self, buffer: TensorDictBase) -> TensorDictBase:
        return buffer.select(*self.agent.seen_keys, LABEL)

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        """As ``Algorithm.update``; afterwards only episodes of the learner count as ended."""
        losses = super().update(buffer)
        buffer["next", "done"] &= buffer[LEARNER]
        return {**losses, "share": float(buffer[LEARNER].float().mean())}

    def _learn(self) -> dict[str, Tensor]:
        frames, actor = self._minibatch(), self._actor
        label: Any = frames[LABEL]
        loc, scale = actor.head(actor.trunk(*(frames[key] for key in self.agent.seen_keys)))
        error = functional.smooth_l1_loss(loc, label, reduction="none", beta=self.config.bend)
        imitation = error.mean()
        left = (loc.detach() - label) ** 2
        likelihood = (scale.log() + left / (2 * scale**2)).mean()
        reported = {
            "loss_imitation": imitation,
            "error": (loc - label).abs().mean(),
            "sigma": scale.mean(),
        }
        step(self._optimizers["all"], imitation + likelihood)
        return {name: one.detach() for name, one in reported.items()}

    def _pace(self, share: float) -> float:
        """Half a cosine."""
        return (1 + math.cos(math.pi * share)) / 2
