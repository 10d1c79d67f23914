"""Proximal policy optimisation as ML-Agents runs it, from TorchRL's parts."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.gradients import GradientSum
from needlehoop.learning.networks import HeadConfig
from needlehoop.learning.normalizer import Normalizer

_LEARNING_RATE_END = 1e-10
"""ML-Agents' floor of the linear schedule."""

_LEARNT_FROM = ("action", "action_log_prob", "state_value", "advantage", "value_target")

_LOOKED_AT = 16
"""Rows whose values a thread works out at a time."""

_OUTPUTS = ("loc", "scale", "state_value_now")
"""Of the agent, as the loss knows them; ``state_value`` is the one it collected with."""

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
        agent: policy and value function; updated in place. ``computing`` is the copy of it
            to collect with.
        config: hyperparameters.
        updates: buffers until the schedules end.
        seed: decides the minibatches.
        workers: that work on a minibatch's shards; the result is the same with any number.
    """

    def __init__(self, agent: Agent, config: PpoConfig, updates: int, seed: int, workers: Workers):
        self.agent, self.config, self.updates = agent, config, updates
        self.done_updates = 0
        self._gae = GAE(
            gamma=config.gamma,
            lmbda=config.lam,
            value_network=None,
            # Standardised once per buffer, not per minibatch.
            average_gae=True,
        )
        policy: Any = ProbabilisticActor(
            TensorDictModule(_Given(), in_keys=["loc", "scale"], out_keys=["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
        )
        self._loss: Any = ClipPPOLoss(
            policy,
            TensorDictModule(_Given(), in_keys=[_OUTPUTS[-1]], out_keys=["state_value"]),
            clip_epsilon=config.epsilon,
            clip_value=config.clip_value,
            entropy_coeff=config.beta,
            critic_coeff=config.value_coefficient,
            loss_critic_type="l2",
            functional=False,
        ).to(next(agent.parameters()).device)
        parameters = list(agent.parameters())
        self._optimizer = torch.optim.Adam(parameters, lr=config.learning_rate, fused=True)
        self._workers = workers
        self._sum = GradientSum(parameters, workers)
        self.computing = agent.computing()
        self._learnt = list(self.computing.parameters())
        self._normalizers = {
            path.rpartition(".")[2]: module
            for path, module in agent.named_modules()
            if isinstance(module, Normalizer)
        }
        self._generator = torch.Generator().manual_seed(seed)

    def update(self, batch: TensorDictBase, after: TensorDictBase) -> dict[str, float]:
        """Learn from a buffer; returns means over its minibatches.

        Args:
            batch: ``(num_envs, horizon)`` steps.
            after: what was seen after its cuts; both as ``Collector.collect`` returns them.
        """
        self._schedule()
        self._estimate(batch, after)
        steps = batch.select(*_LEARNT_FROM).reshape(-1)
        seen = [batch[key].flatten(0, 1) for key in self.agent.seen_keys]
        totals: defaultdict[str, float] = defaultdict(float)
        count = 0
        for _ in range(self.config.epochs):
            order = torch.randperm(len(steps), generator=self._generator)
            for rows in order.split(self.config.minibatch):
                for name, value in self._descend(steps[rows], seen, rows).items():
                    totals[name] += value
                count += 1
        for name, normalizer in self._normalizers.items():
            normalizer.learn(batch[name])
        self.computing.follow(self.agent)
        self.done_updates += 1
        return {
            **{name: value / count for name, value in totals.items()},
            "explained_variance": _explained_variance(batch["state_value"], batch["value_target"]),
            "learning_rate": self._optimizer.param_groups[0]["lr"],
            "epsilon": float(self._loss.clip_epsilon),
            "sigma": float(batch["scale"].mean()),
        }

    def _descend(self, steps: TensorDictBase, seen: list[Tensor], rows: Tensor) -> dict[str, float]:
        """One step of the optimiser on a minibatch; returns what the loss reports.

        Networks are run and differentiated in shards, each by one thread, and their gradients
        are added in order: the result does not depend on how many threads there are.
        """
        shards = rows.chunk(self.config.shards)
        said = self._workers.map(
            lambda shard: self.computing.outputs(*(x.index_select(0, shard) for x in seen)), shards
        )
        slopes, told = self._judge(steps, [torch.cat(parts) for parts in zip(*said, strict=True)])
        per_shard = zip(*(slope.split([len(s) for s in shards]) for slope in slopes), strict=True)
        self._sum(
            self._workers.map(
                lambda outputs, slopes: torch.autograd.grad(outputs, self._learnt, slopes),
                said,
                per_shard,
            )
        )
        self._optimizer.step()
        self.computing.follow(self.agent)
        return told

    def _judge(
        self, steps: TensorDictBase, said: list[Tensor]
    ) -> tuple[tuple[Tensor, ...], dict[str, float]]:
        """The loss's gradient by each of the agent's outputs, and what it reports."""
        leaves = [output.detach().requires_grad_() for output in said]
        outputs = TensorDict(dict(zip(_OUTPUTS, leaves, strict=True)), steps.batch_size)
        losses = self._loss(outputs.update(steps))
        total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
        told = {name: float(losses[key].detach()) for name, key in LOGGED.items()}
        return torch.autograd.grad(total, leaves), told

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

    def _estimate(self, batch: TensorDictBase, after: TensorDictBase) -> None:
        """Write advantages and value targets; time-outs bootstrap.

        The value of a step's successor is that of the next row, which the policy computed
        on the way; only where an episode or the buffer was cut off has it to be asked for.
        """
        values = batch["state_value"]
        following = torch.cat((values[:, 1:], torch.zeros_like(values[:, :1])), 1)
        cut = batch["next", "truncated"].squeeze(-1).clone()
        cut[:, -1] = True
        observed = [after[key].split(_LOOKED_AT) for key in self.agent.in_keys]
        following[cut] = torch.cat(self._workers.map(self._value, *observed))
        batch["next", "state_value"] = following
        self._gae(batch)

    @torch.no_grad()
    def _value(self, *observed: Tensor) -> Tensor:
        _, _, value = self.computing.outputs(*self.computing.prepare(*observed))
        return value

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
        self.computing.follow(self.agent)
        self._optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self.done_updates = state["done_updates"]


class _Given(nn.Module):
    """Passes on what it is given: the loss reads outputs that the agent has made."""

    def forward(self, *values: Tensor) -> Any:
        first, *rest = values
        return values if rest else first


def _explained_variance(values: Tensor, targets: Tensor) -> float:
    """Share of the targets' variance that the values foresaw; NaN for constant targets."""
    variance = targets.var()
    return float(1 - (targets - values).var() / variance) if variance > 0 else float("nan")
