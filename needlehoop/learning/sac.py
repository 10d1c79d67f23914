"""Soft actor-critic from images, from TorchRL's parts; images are shifted as in DrQ."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.data.postprocs import MultiStep
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import SACLoss, SoftUpdate

from needlehoop.learning.algorithm import MemoryAlgorithm, step
from needlehoop.learning.algorithm_config import SacConfig
from needlehoop.learning.networks import Agent, HeadConfig, PolicySpec


class Critic(nn.Module):
    """The value of an action, from ``size`` features and ``others``: facts, and the action.

    Its norms keep values from growing until the policy has only its fastest actions left.
    """

    def __init__(self, size: int, others: int, network: HeadConfig):
        super().__init__()
        # As in DrQ-v2: beside hundreds of features an action hardly counts.
        few = 50
        self.squeeze = nn.Sequential(nn.Linear(size, few), nn.LayerNorm(few), nn.Tanh())
        self.layers = MLP(
            in_features=few + others,
            out_features=1,
            num_cells=[network.hidden] * network.layers,
            activation_class=nn.SiLU,
            norm_class=nn.LayerNorm,
            norm_kwargs={"normalized_shape": network.hidden},
        )

    def forward(self, features: Tensor, *others: Tensor) -> Tensor:
        return self.layers(self.squeeze(features), *others)


class SacAgent(Agent):
    """A policy, and two critics that read the features of its encoders."""

    def __init__(self, spec: PolicySpec, device: torch.device):
        super().__init__(spec, spec.trunk(device))
        others = len(self.privileged_keys) + spec.actions
        critics = (Critic(self.actor.trunk.size, others, spec.network) for _ in range(2))
        self.critics = nn.ModuleList(critics)


class Sac(MemoryAlgorithm):
    """Learns from all steps so far, after each new buffer of them.

    The critics train the encoders; the policy reads their features as they are.
    """

    agent_class = SacAgent
    config: SacConfig

    def __init__(self, agent: SacAgent, config: SacConfig, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        trunk, gaussian = agent.actor.trunk, agent.actor.head
        self._see = TensorDictModule(trunk.see, agent.seen_keys, ["features"])
        head = _drawn(nn.Sequential(trunk.layers, gaussian), "features")
        seeing: Any = TensorDictModule(trunk, agent.seen_keys, ["hidden"])
        self.policy = TensorDictSequential(seeing, _drawn(gaussian, "hidden"))
        inputs: list[Any] = ["features", *agent.privileged_keys, "action"]
        critics = [TensorDictModule(q, inputs, ["state_action_value"]) for q in agent.critics]
        self._loss: Any = SACLoss(
            head,
            critics,
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=config.alpha,
            target_entropy=-float(gaussian.mean.out_features),
            # For two networks a loop is as fast.
            deactivate_vmap=True,
        ).to(self.device)
        self._loss.make_value_estimator(gamma=config.gamma)
        self._targets = SoftUpdate(self._loss, tau=config.tau)
        self._ahead = MultiStep(config.gamma, config.n_steps)
        # It would leave these where they are, and value what follows an episode's end.
        self._ahead.done_keys = ()
        weights = self._loss.qvalue_network_params.values(True, True)
        self._adam([*weights, *trunk.encoders.parameters()], "critics")
        self._adam([*trunk.layers.parameters(), *gaussian.parameters()], "actor")
        self._adam([self._loss.log_alpha], "alpha")

    def _kept(self, buffer: TensorDictBase) -> TensorDictBase:
        keys = self.agent.in_keys
        following = [("next", key) for key in (*keys, "reward", "done", "terminated")]
        ahead = self._ahead(buffer.select(*keys, "action", *following))
        return ahead.select(*keys, "action", *following, "steps_to_next_obs")

    def _learn(self) -> dict[str, Tensor]:
        frames = self._minibatch()
        with torch.no_grad():
            self._see(frames["next"])
        value, _ = self._loss.qvalue_v2_loss(self._see(frames))
        step(self._optimizers["critics"], value)
        frames["features"] = frames["features"].detach()
        policy, metadata = self._loss.actor_loss(frames)
        step(self._optimizers["actor"], policy)
        entropy = -metadata["log_prob"]
        alpha = self._loss.alpha_loss(-entropy).mean()
        step(self._optimizers["alpha"], alpha)
        self._targets.step()
        reported = {
            "loss_value": value,
            "loss_policy": policy,
            "loss_alpha": alpha,
            "entropy": entropy.mean(),
            "alpha": self._loss.log_alpha.exp(),
            "sigma": self.agent.actor.head.log_sigma.exp().mean(),
        }
        return {name: one.detach() for name, one in reported.items()}

    def _pace(self, share: float) -> float:
        """Constant, but for the last fifth: the policy comes to rest."""
        return min(1.0, 5 * (1 - share))

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "loss": self._loss.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self._loss.load_state_dict(state["loss"])


def _drawn(gaussian: nn.Module, key: str) -> Any:
    """Draws actions from what a policy's head makes of ``key``."""
    head: Any = TensorDictModule(gaussian, [key], ["loc", "scale"])
    return ProbabilisticActor(head, ["loc", "scale"], distribution_class=TanhNormal)
