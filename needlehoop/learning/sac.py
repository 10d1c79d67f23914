"""Soft actor-critic from images, from TorchRL's parts; images are shifted as in DrQ."""

from __future__ import annotations

from collections import Counter
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import SACLoss, SoftUpdate

from needlehoop.learning.agent import Actor
from needlehoop.learning.algorithm import Algorithm, Memory, step
from needlehoop.learning.algorithm_config import SacConfig
from needlehoop.learning.encoder import Fold, linear
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk, dense
from needlehoop.learning.policy_spec import PolicySpec


class ActionValue(nn.Module):
    """What an action ``(n, actions)`` is worth where features ``(n, size)`` are seen, ``(n, 1)``.

    Args:
        size: of all inputs together.
    """

    def __init__(self, size: int, heads: HeadConfig):
        super().__init__()
        self.layers = nn.Sequential(*dense(size, heads), linear(heads.hidden, 1))

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.layers(torch.cat([one.float() for one in inputs], -1))


class SacAgent(nn.Module):
    """A policy, and two critics that read the features of its encoders."""

    def __init__(self, spec: PolicySpec, dtype: torch.dtype):
        super().__init__()
        heads = spec.network
        told = heads.told or ()
        self.fold = Fold(spec.encoder.stem)
        self.trunk = Trunk(spec.images, spec.vectors, spec.encoder, heads, dtype)
        self.gaussian = Gaussian(heads.hidden, spec.actions, heads.sigma, heads.squash)
        size = self.trunk.size + len(told) + spec.actions
        self.critics = nn.ModuleList(ActionValue(size, heads) for _ in range(2))
        self.seen_keys = spec.keys
        self.in_keys: list[Any] = [*spec.keys, *(("facts", name) for name in told)]

    @property
    def actor(self) -> Actor:
        """The policy alone: the same modules."""
        return Actor(self.fold, self.trunk, self.gaussian)


class Sac(Algorithm):
    """Learns from all steps so far, after each new buffer of them.

    The critics train the encoders; the policy reads their features as they are.
    """

    config: SacConfig

    def __init__(self, agent: SacAgent, config: SacConfig, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        trunk = agent.trunk
        self._see = TensorDictModule(trunk.see, in_keys=agent.seen_keys, out_keys=["features"])
        given: Any = TensorDictModule(
            nn.Sequential(trunk.layers, agent.gaussian), ["features"], ["loc", "scale"]
        )
        head = ProbabilisticActor(given, ["loc", "scale"], distribution_class=TanhNormal)
        seeing: Any = TensorDictModule(trunk, agent.seen_keys, ["hidden"])
        acting: Any = TensorDictModule(agent.gaussian, ["hidden"], ["loc", "scale"])
        drawing: Any = ProbabilisticActor(acting, ["loc", "scale"], distribution_class=TanhNormal)
        self.policy = TensorDictSequential(seeing, drawing)
        told = agent.in_keys[len(agent.seen_keys) :]
        inputs: list[Any] = ["features", *told, "action"]
        critics = [TensorDictModule(q, inputs, ["state_action_value"]) for q in agent.critics]
        self._loss: Any = SACLoss(
            head,
            critics,
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=config.alpha,
            target_entropy=-float(agent.gaussian.mean.out_features),
            # Of two networks; a loop takes no longer.
            deactivate_vmap=True,
        ).to(self.device)
        self._loss.make_value_estimator(gamma=config.gamma)
        self._targets = SoftUpdate(self._loss, tau=config.tau)
        critics_s = self._loss.qvalue_network_params.values(True, True)
        eyes = [*trunk.encoders.parameters(), *trunk.normalizers.parameters()]
        self._adam([*critics_s, *eyes], "critics")
        self._adam([*trunk.layers.parameters(), *agent.gaussian.parameters()], "actor")
        self._adam([self._loss.log_alpha], "alpha")
        own = (config.memory, config.minibatch, self.device, self._generator)
        self._memory = Memory(*own)

    @staticmethod
    def agent_of(spec: PolicySpec, dtype: torch.dtype) -> SacAgent:
        return SacAgent(spec, dtype)

    def remember(self, buffer: TensorDictBase) -> None:
        keys = self.agent.in_keys
        ends = ("reward", "done", "terminated")
        after = [("next", *(key if isinstance(key, tuple) else (key,))) for key in keys]
        kept = buffer.select(*keys, "action", *after, *(("next", one) for one in ends))
        self._memory.extend(kept.reshape(-1))

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        self.remember(buffer)
        totals = Counter[str]()
        for _ in range(self.config.minibatches):
            totals.update(self._learn())
        self._end_update(buffer)
        return {
            **{name: float(value) / self.config.minibatches for name, value in totals.items()},
            "frames": float(len(self._memory)),
            "learning_rate": self.config.learning_rate,
        }

    def _learn(self) -> dict[str, Tensor]:
        """A minibatch; returns what is reported of it."""
        frames = self._memory.sample(self.agent.fold, self.config.picture_shift)
        with torch.no_grad():
            self._see(frames["next"])
        value, _ = self._loss.qvalue_v2_loss(self._see(frames))
        step(self._optimizers["critics"], value)
        frames["features"] = frames["features"].detach()
        policy, found = self._loss.actor_loss(frames)
        step(self._optimizers["actor"], policy)
        entropy = -found["log_prob"]
        alpha = self._loss.alpha_loss(-entropy).mean()
        step(self._optimizers["alpha"], alpha)
        self._targets.step()
        told = {
            "loss_value": value,
            "loss_policy": policy,
            "loss_alpha": alpha,
            "entropy": entropy.mean(),
            "alpha": self._loss.log_alpha.exp(),
            "sigma": self.agent.gaussian.log_sigma.exp().mean(),
        }
        return {name: one.detach() for name, one in told.items()}

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "loss": self._loss.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self._loss.load_state_dict(state["loss"])
