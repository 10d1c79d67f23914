"""The agent's networks, put together: policy and value function.

- ``Agent``: what PPO and imitation train, with the TorchRL modules that training calls.
- ``Actor``: the policy alone, from observations to the action. Evaluations use it, and it is what
  ``policy.safetensors`` holds.
- ``policy.Policy``: an ``Actor`` for users. It takes named observations, in NumPy or torch, and
  checks them.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor

from needlehoop.learning.encoder import Fold, convolution_dtype
from needlehoop.learning.networks import Gaussian, Trunk, Value
from needlehoop.learning.policy_spec import PolicySpec


class Actor(nn.Module):
    """The policy's part of an agent: observations to the action, on plain tensors."""

    def __init__(self, fold: Fold, trunk: Trunk, head: Gaussian):
        super().__init__()
        self._images = len(trunk.encoders)
        self.fold, self.trunk, self.head = fold, trunk, head

    def forward(self, *observed: Tensor, noise: Tensor | None = None) -> Tensor:
        """Actions ``(..., action_size)`` of images ``(..., c, h, w)`` uint8, then vectors.

        Args:
            noise: standard normal, to draw the actions as in training; else they are the mean.
        """
        images, vectors = observed[: self._images], observed[self._images :]
        return self.head.act(self.trunk(*(self.fold(image) for image in images), *vectors), noise)


class Agent(nn.Module):
    """Policy and value function over a shared trunk, or over one each.

    Args:
        dtype: of the convolutions.

    Raises:
        ValueError: images that do not fit the encoder.
    """

    def __init__(self, spec: PolicySpec, dtype: torch.dtype):
        super().__init__()
        heads = spec.network
        told = heads.told or ()
        self.fold = Fold(spec.encoder.stem)
        self.trunks = nn.ModuleList(
            Trunk(spec.images, spec.vectors, spec.encoder, heads, dtype)
            for _ in range(1 if heads.shared else 2)
        )
        self.gaussian = Gaussian(heads.hidden, spec.actions, heads.sigma, heads.squash)
        self.value = Value(heads.hidden, len(told))
        self.seen_keys = spec.keys
        """What the policy sees of an environment that folds its images."""
        self.in_keys: list[Any] = [*spec.keys, *(("facts", name) for name in told)]
        """And what the value function is told beside it."""

    @property
    def actor(self) -> Actor:
        """The policy alone: the same modules, so loading weights into it loads them here too."""
        trunk: Any = self.trunks[0]
        return Actor(self.fold, trunk, self.gaussian)

    def torchrl(self) -> tuple[Any, Any, Any]:
        """The same modules for TorchRL: what comes before both heads, the policy's, the value's."""
        hidden = ["hidden", "hidden_of_value"][: len(self.trunks)]
        ways: list[Any] = [
            TensorDictModule(trunk, in_keys=self.seen_keys, out_keys=[name])
            for trunk, name in zip(self.trunks, hidden, strict=True)
        ]
        common = TensorDictSequential(*ways)
        given: Any = TensorDictModule(self.gaussian, in_keys=["hidden"], out_keys=["loc", "scale"])
        policy = ProbabilisticActor(
            given,
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )
        facts = self.in_keys[len(self.seen_keys) :]
        value = TensorDictModule(self.value, in_keys=[hidden[-1], *facts], out_keys=["state_value"])
        return common, policy, value


def build_actor(spec: PolicySpec, device: torch.device) -> Actor:
    """An untrained policy; needs no simulator."""
    heads, dtype = spec.network, convolution_dtype(spec.precision, device)
    trunk = Trunk(spec.images, spec.vectors, spec.encoder, heads, dtype)
    head = Gaussian(heads.hidden, spec.actions, heads.sigma, heads.squash)
    return Actor(Fold(spec.encoder.stem), trunk, head)
