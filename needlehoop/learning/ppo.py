"""Proximal policy optimisation as ML-Agents runs it, from TorchRL's parts."""

from __future__ import annotations

from collections import Counter
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor
from torchrl.modules import IndependentNormal, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from needlehoop.learning.algorithm import Algorithm, step
from needlehoop.learning.algorithm_config import PpoConfig
from needlehoop.learning.networks import ValueAgent

_LEARNING_RATE_END = 1e-10
"""ML-Agents' floor of the linear schedule."""

LOGGED = {
    "loss_policy": "loss_objective",
    "loss_value": "loss_critic",
    "loss_entropy": "loss_entropy",
    "entropy": "entropy",
    "kl": "kl_approx",
    "clip_fraction": "clip_fraction",
}
"""Our names of what TorchRL's loss reports."""


class Ppo(Algorithm):
    """Learns from one buffer after the other; the learning rate falls linearly.

    In the warm-up, the trunk that value function and policy share does not learn.
    """

    agent_class = ValueAgent
    config: PpoConfig

    def __init__(self, agent: ValueAgent, config: PpoConfig, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        self._common, head, self._value = _modules(agent)
        self.policy = TensorDictSequential(self._common, head, self._value)
        # Standardised once per buffer, not per minibatch.
        self._gae = GAE(gamma=config.gamma, lmbda=config.lam, value_network=None, average_gae=True)
        # It reads ``hidden``, so the common part is computed once for both heads.
        self._loss: Any = ClipPPOLoss(
            head,
            self._value,
            clip_epsilon=config.epsilon,
            clip_value=config.clip_value,
            entropy_coeff=config.beta,
            critic_coeff=config.value_coefficient,
            loss_critic_type="l2",
            functional=False,
        ).to(self.device)
        # The warm-up has an optimiser of its own: its moments hold no gradient of the policy.
        policys = set(agent.actor.parameters())
        self._adam([one for one in agent.parameters() if one not in policys], "value")
        self._adam([*agent.parameters()])

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        optimizer, rate = self._schedule()
        self._estimate(buffer)
        learnt_from = ("action", "action_log_prob", "state_value", "advantage", "value_target")
        steps = buffer.select(*self.agent.in_keys, *learnt_from).reshape(-1)
        totals, count = Counter[str](), 0
        for _ in range(self.config.epochs):
            order = torch.randperm(len(steps), generator=self._generator).to(self.device)
            for rows in order.split(self.config.minibatch):
                losses = self._loss(self._common(steps[rows]))
                step(
                    optimizer,
                    losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"],
                )
                totals.update({name: losses[key].detach() for name, key in LOGGED.items()})
                count += 1
        self._end_update(buffer)
        values, targets = buffer["state_value"], buffer["value_target"]
        return {
            **{name: float(value) / count for name, value in totals.items()},
            "explained_variance": _explained_variance(values, targets),
            "learning_rate": rate,
            "epsilon": float(self._loss.clip_epsilon),
            "sigma": float(buffer["scale"].mean()),
        }

    def _schedule(self) -> tuple[torch.optim.Optimizer, float]:
        """Set learning rate and clipping; returns the optimiser in use, and its rate."""
        config, left = self.config, 1.0 - self.done_updates / self.updates
        warms_up = self.done_updates < config.warmup
        for parameter in self.agent.actor.parameters():
            parameter.requires_grad_(not warms_up)
        share = 1.0 if warms_up else config.finetune
        rate = max(share * config.learning_rate * left, _LEARNING_RATE_END)
        optimizer = self._optimizers["value" if warms_up else "all"]
        optimizer.param_groups[0]["lr"] = rate
        epsilon = config.epsilon_end + (config.epsilon - config.epsilon_end) * left
        self._loss.clip_epsilon.fill_(epsilon)
        if config.clip_value:
            self._loss.clip_value.fill_(epsilon)
        return optimizer, rate

    @torch.no_grad()
    def _estimate(self, buffer: TensorDictBase) -> None:
        """Write advantages and value targets, looking a horizon ahead; time-outs bootstrap.

        The value of a step's successor is that of the next row. It is computed anew only where
        an episode or the buffer was cut off.
        """
        values: Any = buffer["state_value"]
        following = torch.cat((values[:, 1:], torch.zeros_like(values[:, :1])), 1)
        cut = buffer["next", "truncated"].squeeze(-1).clone()
        cut[:, -1] = True
        last = buffer["next"].select(*self.agent.in_keys)[cut]
        following[cut] = self._value(self._common(last))["state_value"]
        buffer["next", "state_value"] = following
        needed = ("reward", "done", "terminated", "state_value")
        pieces = buffer.select("state_value", *(("next", key) for key in needed))
        pieces = pieces.reshape(-1, self.config.horizon)
        self._gae(pieces)
        for key in ("advantage", "value_target"):
            buffer[key] = pieces[key].reshape(values.shape)


def _explained_variance(values: Tensor, targets: Tensor) -> float:
    """Share of the targets' variance that the values explain; NaN for constant targets."""
    variance = targets.var()
    return float(1 - (targets - values).var() / variance) if variance > 0 else float("nan")


def _modules(agent: ValueAgent) -> tuple[Any, Any, Any]:
    """What comes before both heads, the policy's head, and the value's, for TorchRL."""
    trunks = {"hidden": agent.actor.trunk}
    if agent.value_trunk is not None:
        trunks["hidden_of_value"] = agent.value_trunk
    common: list[Any] = [
        TensorDictModule(trunk, agent.seen_keys, [name]) for name, trunk in trunks.items()
    ]
    head: Any = TensorDictModule(agent.actor.head, ["hidden"], ["loc", "scale"])
    policy = ProbabilisticActor(
        head,
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    inputs = [[*trunks][-1], *agent.privileged_keys]
    value = TensorDictModule(agent.value, inputs, ["state_value"])
    return TensorDictSequential(*common), policy, value
