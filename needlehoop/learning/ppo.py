"""Proximal policy optimisation as ML-Agents runs it, from TorchRL's parts."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from needlehoop.learning.agent import Agent
from needlehoop.learning.networks import HeadConfig
from needlehoop.learning.normalizer import Normalizer

_LEARNING_RATE_END = 1e-10
"""ML-Agents' floor of the linear schedule."""

_LEARNT_FROM = ("action", "action_log_prob", "state_value", "advantage", "value_target")

LOGGED = {
    "loss_policy": "loss_objective",
    "loss_value": "loss_critic",
    "loss_entropy": "loss_entropy",
    "entropy": "entropy",
    "kl": "kl_approx",
    "clip_fraction": "clip_fraction",
}
"""Our names of what TorchRL's loss reports."""


@dataclass(frozen=True)
class PpoConfig:
    """Values in ``conf/algo/ppo.yaml``; a buffer holds ``num_envs * horizon`` steps."""

    horizon: int
    """Steps of each environment per buffer."""
    minibatch: int
    shards: int
    """Parts of a minibatch that threads work on side by side."""
    epochs: int
    """Passes over a buffer."""
    learning_rate: float
    """At the start; falls linearly to nothing."""
    gamma: float
    lam: float
    """GAE's lambda."""
    beta: float
    """Weight of the entropy; constant."""
    epsilon: float
    """Clipping of probability ratios and value moves; falls linearly to ``epsilon_end``."""
    epsilon_end: float
    value_coefficient: float
    clip_value: bool
    """Whether a value may move no further than epsilon per buffer."""
    network: HeadConfig

    def __post_init__(self) -> None:
        for key in ("horizon", "minibatch", "shards", "epochs"):
            if getattr(self, key) < 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be at least 1")
        for key in ("learning_rate", "epsilon", "epsilon_end", "value_coefficient"):
            if not getattr(self, key) > 0:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be positive")
        for key in ("gamma", "lam"):
            if not 0 <= getattr(self, key) <= 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be between 0 and 1")
        if not self.beta >= 0:
            raise ValueError(f"algo.beta: {self.beta} must not be negative")


class Ppo:
    """Learns from one buffer after the other.

    Args:
        agent: policy and value function; updated in place.
        config: hyperparameters.
        updates: buffers until the schedules end.
        seed: decides the minibatches.
        threads: that may work on a minibatch's shards; the result is the same with any number.
    """

    def __init__(self, agent: Agent, config: PpoConfig, updates: int, seed: int, threads: int):
        self.agent, self.config, self.updates = agent, config, updates
        self.done_updates = 0
        self._critic = agent.operator.get_value_operator()
        self._gae = GAE(
            gamma=config.gamma,
            lmbda=config.lam,
            value_network=None,
            # Standardised once per buffer, not per minibatch.
            average_gae=True,
        )
        policy: Any = agent.operator.get_policy_operator()
        self._loss: Any = ClipPPOLoss(
            policy,
            # The head alone: the policy has just computed the trunk.
            agent.operator.get_value_head(),
            clip_epsilon=config.epsilon,
            clip_value=config.clip_value,
            entropy_coeff=config.beta,
            critic_coeff=config.value_coefficient,
            loss_critic_type="l2",
            functional=False,
        )
        self._parameters = list(agent.parameters())
        self._optimizer = torch.optim.Adam(self._parameters, lr=config.learning_rate)
        self._pool = ThreadPoolExecutor(min(threads, config.shards))
        self._normalizers = {
            path.rpartition(".")[2]: module
            for path, module in agent.named_modules()
            if isinstance(module, Normalizer)
        }
        self._generator = torch.Generator().manual_seed(seed)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a buffer ``(num_envs, horizon)``; returns means over its minibatches."""
        self._schedule()
        self._estimate(batch)
        steps = batch.select(*self._critic.in_keys, *_LEARNT_FROM).reshape(-1)
        totals: defaultdict[str, float] = defaultdict(float)
        count = 0
        for _ in range(self.config.epochs):
            order = torch.randperm(len(steps), generator=self._generator)
            for rows in order.split(self.config.minibatch):
                for name, value in self._descend(steps, rows).items():
                    totals[name] += value
                count += 1
        for name, normalizer in self._normalizers.items():
            normalizer.learn(batch[name])
        self.done_updates += 1
        return {
            **{name: value / count for name, value in totals.items()},
            "explained_variance": _explained_variance(batch["state_value"], batch["value_target"]),
            "learning_rate": self._optimizer.param_groups[0]["lr"],
            "epsilon": float(self._loss.clip_epsilon),
            "sigma": float(batch["scale"].mean()),
        }

    def _descend(self, steps: TensorDictBase, rows: Tensor) -> dict[str, float]:
        """One step of the optimiser on a minibatch; returns what the loss reports.

        Every shard's gradient is worked out by one thread and they are added in order: the
        result does not depend on how many threads there are.
        """
        shards = rows.chunk(self.config.shards)
        weights = [len(shard) / len(rows) for shard in shards]
        parts = list(self._pool.map(lambda shard: self._gradient(steps[shard]), shards))
        for index, parameter in enumerate(self._parameters):
            weighted = [
                w * gradient[index] for w, (gradient, _) in zip(weights, parts, strict=True)
            ]
            parameter.grad = sum(weighted[1:], weighted[0])
        self._optimizer.step()
        return {
            name: sum(w * told[name] for w, (_, told) in zip(weights, parts, strict=True))
            for name in LOGGED
        }

    def _gradient(self, steps: TensorDictBase) -> tuple[tuple[Tensor, ...], dict[str, float]]:
        losses = self._loss(steps)
        total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
        gradient = torch.autograd.grad(total, self._parameters)
        return gradient, {name: float(losses[key].detach()) for name, key in LOGGED.items()}

    def _schedule(self) -> None:
        left = 1.0 - self.done_updates / self.updates
        rate = max(self.config.learning_rate * left, _LEARNING_RATE_END)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        end = self.config.epsilon_end
        epsilon = end + (self.config.epsilon - end) * left
        self._loss.clip_epsilon.fill_(epsilon)
        if self.config.clip_value:
            self._loss.clip_value.fill_(epsilon)

    @torch.no_grad()
    def _estimate(self, batch: TensorDictBase) -> None:
        """Write advantages and value targets; time-outs bootstrap.

        The value of a step's successor is that of the next row, which the policy computed
        on the way; only where an episode or the buffer was cut off has it to be asked for.
        """
        values = batch["state_value"]
        following = torch.cat((values[:, 1:], torch.zeros_like(values[:, :1])), 1)
        cut = batch["next", "truncated"].squeeze(-1).clone()
        cut[:, -1] = True
        ends: Any = batch["next"]
        successors = ends.select(*self.agent.in_keys)[cut]
        following[cut] = self._critic(self.agent.fold(successors))["state_value"]
        batch["next", "state_value"] = following
        self._gae(batch)

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides the next update."""
        return {
            "agent": self.agent.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "generator": self._generator.get_state(),
            "done_updates": self.done_updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self.agent.load_state_dict(state["agent"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self.done_updates = state["done_updates"]


def _explained_variance(values: Tensor, targets: Tensor) -> float:
    """Share of the targets' variance that the values foresaw; NaN for constant targets."""
    variance = targets.var()
    return float(1 - (targets - values).var() / variance) if variance > 0 else float("nan")
