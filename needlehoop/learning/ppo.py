"""Proximal policy optimisation as ML-Agents runs it, from TorchRL's parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import IndependentNormal, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.job import PpoConfig
from needlehoop.learning.trainer import Trainer

_LEARNING_RATE_END = 1e-10
"""ML-Agents' floor of the linear schedule."""

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


class Ppo(Trainer):
    """Learns from one buffer after the other.

    In the warm-up, the trunk that value function and policy share does not learn.
    """

    def __init__(self, agent: Agent, config: PpoConfig, updates: int, seed: int, workers: Workers):
        super().__init__(agent, config.shards, updates, seed, workers)
        self.config = config
        self._gae = GAE(
            gamma=config.gamma,
            lmbda=config.lam,
            value_network=None,
            # Standardised once per buffer, not per minibatch.
            average_gae=True,
        )
        # The loss reads outputs that the agent has made; nothing is run for it.
        given: Any = TensorDictModule(lambda *said: said, ["loc", "scale"], ["loc", "scale"])
        policy: Any = ProbabilisticActor(
            given, in_keys=["loc", "scale"], distribution_class=IndependentNormal
        )
        value: Any = TensorDictModule(lambda said: said, [_OUTPUTS[-1]], ["state_value"])
        self._loss: Any = ClipPPOLoss(
            policy,
            value,
            clip_epsilon=config.epsilon,
            clip_value=config.clip_value,
            entropy_coeff=config.beta,
            critic_coeff=config.value_coefficient,
            loss_critic_type="l2",
            functional=False,
        ).to(next(agent.parameters()).device)
        policy_s = {id(weight) for weight in agent.actor.parameters()}
        self._policy_s = {i for i, w in enumerate(agent.parameters()) if id(w) in policy_s}

    def update(self, batch: TensorDictBase, after: TensorDictBase) -> dict[str, float]:
        """Learn from a buffer; returns means over its minibatches.

        Args:
            batch: ``(num_envs, horizon)`` steps.
            after: what was seen after its cuts; both as ``Collector.collect`` returns them.
        """
        if self.done_updates == self.config.warmup > 0:
            # Adam's of the warm-up has seen no gradient of the policy, and would leap at one.
            self._optimizer = self._new_optimizer()
        rate = self._schedule()
        self._estimate(batch, after)
        learnt_from = ("action", "action_log_prob", "state_value", "advantage", "value_target")
        steps = batch.select(*learnt_from).reshape(-1)
        seen = [batch[key].flatten(0, 1) for key in self.agent.seen_keys]
        totals, count = Counter[str](), 0
        for _ in range(self.config.epochs):
            order = torch.randperm(len(steps), generator=self._generator)
            for rows in order.to(steps.device).split(self.config.minibatch):
                slopes, told = self._judge(steps[rows], self.running.forward(seen, rows))
                self.running.backward(slopes)
                self._optimizer.step(self._write)
                totals.update(told)
                count += 1
        self._end_update(batch)
        return {
            **{name: value / count for name, value in totals.items()},
            "explained_variance": _explained_variance(batch["state_value"], batch["value_target"]),
            "learning_rate": rate,
            "epsilon": float(self._loss.clip_epsilon),
            "sigma": float(batch["scale"].mean()),
        }

    def _write(self, weight: int, rows: slice, out: Tensor) -> None:
        """A weight's gradient, for the optimiser; none of the policy's in the warm-up."""
        if self.done_updates < self.config.warmup and weight in self._policy_s:
            out.zero_()
        else:
            self.running.write(weight, rows, out)

    def _judge(
        self, steps: TensorDictBase, said: Sequence[Tensor]
    ) -> tuple[tuple[Tensor, ...], dict[str, float]]:
        """The loss's gradient by each of the agent's outputs, and what it reports."""
        leaves = [output.requires_grad_() for output in said]
        outputs = TensorDict(dict(zip(_OUTPUTS, leaves, strict=True)), steps.batch_size)
        losses = self._loss(outputs.update(steps))
        total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
        told = {name: float(losses[key].detach()) for name, key in LOGGED.items()}
        return torch.autograd.grad(total, leaves), told

    def _schedule(self) -> float:
        """Set learning rate and clipping; returns the former."""
        left = 1.0 - self.done_updates / self.updates
        share = 1.0 if self.done_updates < self.config.warmup else self.config.finetune
        rate = max(share * self.config.learning_rate * left, _LEARNING_RATE_END)
        self._optimizer.set_rate(rate)
        end = self.config.epsilon_end
        epsilon = end + (self.config.epsilon - end) * left
        self._loss.clip_epsilon.fill_(epsilon)
        if self.config.clip_value:
            self._loss.clip_value.fill_(epsilon)
        return rate

    def _estimate(self, batch: TensorDictBase, after: TensorDictBase) -> None:
        """Write advantages and value targets, looking a horizon ahead; time-outs bootstrap.

        The value of a step's successor is that of the next row, which the policy computed
        on the way; only where an episode or the buffer was cut off has it to be asked for.
        """
        values = batch["state_value"]
        following = torch.cat((values[:, 1:], torch.zeros_like(values[:, :1])), 1)
        cut = batch["next", "truncated"].squeeze(-1).clone()
        cut[:, -1] = True
        seen = self.agent.prepare(*(after[key] for key in self.agent.in_keys))
        _, _, following[cut] = self.running.outputs(seen)
        batch["next", "state_value"] = following
        pieces = batch.select("state_value", "next").reshape(-1, self.config.horizon)
        self._gae(pieces)
        for key in ("advantage", "value_target"):
            batch[key] = pieces[key].reshape(values.shape)


def _explained_variance(values: Tensor, targets: Tensor) -> float:
    """Share of the targets' variance that the values foresaw; NaN for constant targets."""
    variance = targets.var()
    return float(1 - (targets - values).var() / variance) if variance > 0 else float("nan")
