"""Agents: a policy, and the value function that PPO trains with it."""

from __future__ import annotations

from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor

from needlehoop.learning.encoder import Fold, convolution_dtype
from needlehoop.learning.networks import Gaussian, PolicySpec, Trunk, Value


class Actor(nn.Module):
    """The policy alone, on plain tensors. ``policy.safetensors`` holds it."""

    def __init__(self, fold: Fold, trunk: Trunk, head: Gaussian):
        super().__init__()
        self._images = len(trunk.encoders)
        self.fold, self.trunk, self.head = fold, trunk, head

    def forward(self, *observed: Tensor, noise: Tensor | None = None) -> Tensor:
        """Actions ``(..., action_size)`` of images ``(..., c, h, w)`` uint8, then vectors.

        ``noise``: standard normal, to draw the actions as in training; ``None``: the mean.
        """
        images, vectors = observed[: self._images], observed[self._images :]
        return self.head.act(self.trunk(*(self.fold(image) for image in images), *vectors), noise)


def build_actor(spec: PolicySpec, device: torch.device) -> Actor:
    """An untrained policy; needs no simulator."""
    dtype = convolution_dtype(spec.precision, device)
    return Actor(Fold(spec.encoder.stem), spec.trunk(dtype), Gaussian(spec))


class Agent(nn.Module):
    """A policy; a method of training adds what it learns with. ``dtype``: of the convolutions."""

    trunk: Any
    gaussian: Any

    def __init__(self, spec: PolicySpec, dtype: torch.dtype):
        super().__init__()
        self.fold = Fold(spec.encoder.stem)
        self.seen_keys = spec.keys
        """What the policy reads of an environment that folds its images."""
        self.privileged_keys: list[Any] = [("facts", name) for name in spec.network.told or ()]
        """Facts that only the value function reads."""
        self.in_keys = [*self.seen_keys, *self.privileged_keys]

    @property
    def actor(self) -> Actor:
        """The policy alone: the same modules, so loading weights into it loads them here too."""
        return Actor(self.fold, self.trunk, self.gaussian)


class ValueAgent(Agent):
    """Policy and value function over a shared trunk, or over one each."""

    def __init__(self, spec: PolicySpec, dtype: torch.dtype):
        super().__init__(spec, dtype)
        heads = spec.network
        self.trunks = nn.ModuleList(spec.trunk(dtype) for _ in range(1 if heads.shared else 2))
        self.gaussian = Gaussian(spec)
        self.value = Value(heads.hidden, len(self.privileged_keys))

    @property
    def trunk(self) -> Any:
        """The policy's."""
        return self.trunks[0]

    def torchrl(self) -> tuple[Any, Any, Any]:
        """The same modules for TorchRL: what comes before both heads, the policy's, the value's."""
        hidden = ["hidden", "hidden_of_value"][: len(self.trunks)]
        ways: list[Any] = [
            TensorDictModule(trunk, in_keys=self.seen_keys, out_keys=[name])
            for trunk, name in zip(self.trunks, hidden, strict=True)
        ]
        given: Any = TensorDictModule(self.gaussian, in_keys=["hidden"], out_keys=["loc", "scale"])
        policy = ProbabilisticActor(
            given,
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )
        inputs = [hidden[-1], *self.privileged_keys]
        value = TensorDictModule(self.value, in_keys=inputs, out_keys=["state_value"])
        return TensorDictSequential(*ways), policy, value
