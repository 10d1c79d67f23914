"""Policies and agents: the networks beyond the encoders, and all that is needed to build them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from torch import Tensor, nn

from needlehoop.config.strict import Names, Range, shown
from needlehoop.learning.encoder import Encoder, EncoderConfig, Fold, convolution_dtype, linear
from needlehoop.scene.image_size import ImageSize, sides


@dataclass(frozen=True)
class HeadConfig:
    """Trunk and heads; ``network`` in ``conf/algo``."""

    hidden: Annotated[int, Range(1, 16_384)]
    """Width of the trunk's layers and of each encoder's output."""
    layers: Annotated[int, Range(1, 64)]
    """Layers of the trunk."""
    sigma: Annotated[float, Range(0.0, 100.0, above=True)]
    """Standard deviation of the first policy, in units of the action (1: its whole range)."""
    shared: bool
    """Whether the value function reads the policy's trunk; otherwise it has one of its own."""
    privileged_facts: Names | None
    """The value function reads them and the policy does not; ``None``: the
    task's choice."""
    squash: bool = False
    """Whether a tanh keeps actions within their range; ``algo=sac`` alone takes it."""


class Normalizer(nn.Module):
    """Standardises vectors ``(..., size)`` by the mean and variance of all that ``learn`` saw.

    The statistics are part of the state dict.
    """

    count: Tensor
    mean: Tensor
    square: Tensor

    def __init__(self, size: int):
        super().__init__()
        for name, shape in (("count", ()), ("mean", (size,)), ("square", (size,))):
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:
        deviation = (self.square - self.mean**2).clamp(min=1e-12).sqrt()
        standard = ((x - self.mean) / deviation).clamp(-5.0, 5.0).float()
        # An exporter to ONNX could not follow a branch of Python.
        return torch.where(self.count == 0, x.float(), standard)

    def learn(self, x: Tensor) -> None:
        """Take the rows of ``x`` into account."""
        rows = x.reshape(-1, x.shape[-1]).double()
        self.count += len(rows)
        share = len(rows) / self.count
        self.mean += share * (rows.mean(0) - self.mean)
        self.square += share * ((rows**2).mean(0) - self.square)


class Trunk(nn.Module):
    """All observations to one feature vector: encoders side by side, then dense layers.

    ``images``: ``(c, h, w)`` by camera. ``vectors``: lengths of the other observations.
    """

    def __init__(
        self,
        images: Mapping[str, torch.Size],
        vectors: Mapping[str, int],
        encoder: EncoderConfig,
        heads: HeadConfig,
        dtype: torch.dtype,
    ):
        super().__init__()
        out = heads.hidden
        encoders = {name: Encoder(shape, encoder, out, dtype) for name, shape in images.items()}
        self.encoders = nn.ModuleDict(encoders)
        self.normalizers = nn.ModuleDict({name: Normalizer(n) for name, n in vectors.items()})
        self.size = size = out * len(images) + sum(vectors.values())
        layers: list[nn.Module] = []
        for _ in range(heads.layers):
            layers += [linear(size, out), nn.SiLU()]
            size = out
        self.layers = nn.Sequential(*layers)

    def forward(self, *observed: Tensor) -> Tensor:
        return self.layers(self.see(*observed))

    def see(self, *observed: Tensor) -> Tensor:
        """What the dense layers read ``(..., size)``: the encoders' outputs, then vectors."""
        readers = (*self.encoders.values(), *self.normalizers.values())
        return torch.cat([read(one) for read, one in zip(readers, observed, strict=True)], -1)


class Gaussian(nn.Module):
    """Policy head: a linear mean and a state-independent log-std, squashed by a tanh or not."""

    def __init__(self, spec: PolicySpec):
        super().__init__()
        heads = spec.network
        self._squash = heads.squash
        self.mean = linear(heads.hidden, spec.actions, gain=0.2)
        self.log_sigma = nn.Parameter(torch.full((spec.actions,), heads.sigma).log())

    def forward(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and deviation, before the tanh."""
        loc = self.mean(hidden)
        return loc, self.log_sigma.exp().expand_as(loc)

    def act(self, hidden: Tensor, noise: Tensor | None = None) -> Tensor:
        """The mean action, or with standard normal ``noise`` one drawn."""
        loc, scale = self(hidden)
        drawn = loc if noise is None else loc + scale * noise
        return drawn.tanh() if self._squash else drawn


class Value(nn.Module):
    """Value head: linear, or with a hidden layer where it reads privileged facts."""

    def __init__(self, inner: int, privileged_facts: int):
        super().__init__()
        size = inner + privileged_facts
        hidden = [linear(size, inner), nn.SiLU()] if privileged_facts else []
        self.layers = nn.Sequential(*hidden, linear(inner, 1))

    def forward(self, hidden: Tensor, *facts: Tensor) -> Tensor:
        return self.layers(torch.cat((hidden, *(fact.float() for fact in facts)), -1))


@dataclass(frozen=True)
class PolicySpec:
    """A policy's inputs, outputs and networks; a policy's file has it under ``senses``."""

    channels: Mapping[str, Annotated[int, Range(1, 1024)]]
    """Of each camera's image, stacked frames included; in the order in which they are read."""
    image_size: ImageSize
    vectors: Mapping[str, Annotated[int, Range(1, 100_000)]]
    """Length of each other observation, in the order in which they are read."""
    encoder: EncoderConfig
    network: HeadConfig
    control: str
    """How its actions move the robot, see ``episode.control``."""
    actions: Annotated[int, Range(1, 1000)]
    """Length of the action."""
    precision: str

    @property
    def images(self) -> dict[str, torch.Size]:
        """The shape ``(c, h, w)`` of each camera's image."""
        width, height = sides(self.image_size)
        return {name: torch.Size((c, height, width)) for name, c in self.channels.items()}

    def trunk(self, device: torch.device) -> Trunk:
        """A new trunk, in the numbers that suit a device."""
        dtype = convolution_dtype(self.precision, device)
        return Trunk(self.images, self.vectors, self.encoder, self.network, dtype)


def check_same(have: PolicySpec, want: PolicySpec, what: str) -> None:
    """Raises ``ValueError``, which begins with ``what``, where the networks differ."""
    for key in PolicySpec.__dataclass_fields__:
        before, now = getattr(have, key), getattr(want, key)
        if before != now:
            raise ValueError(
                f"{what}: the agent's networks were made for {key} {shown(before)}, and this is"
                f" {shown(now)}"
            )


class Actor(nn.Module):
    """The policy alone, on plain tensors. ``policy.safetensors`` holds it."""

    def __init__(self, spec: PolicySpec, trunk: Trunk):
        super().__init__()
        self._images = len(trunk.encoders)
        self.fold, self.trunk, self.head = Fold(spec.encoder.stem), trunk, Gaussian(spec)

    def forward(self, *observed: Tensor, noise: Tensor | None = None) -> Tensor:
        """Actions ``(..., action_size)`` in [-1, 1], of images ``(..., c, h, w)`` uint8, vectors.

        ``noise``: standard normal, to draw the actions as in training; ``None``: the mean.
        """
        images, vectors = observed[: self._images], observed[self._images :]
        hidden = self.trunk(*(self.fold(image) for image in images), *vectors)
        return self.head.act(hidden, noise).clamp(-1.0, 1.0)


class Agent(nn.Module):
    """A policy; a method of training adds what it learns with."""

    def __init__(self, spec: PolicySpec, trunk: Trunk):
        super().__init__()
        self.actor = Actor(spec, trunk)
        images: list[Any] = [("pixels", name) for name in spec.channels]
        self.seen_keys = [*images, *spec.vectors]
        """What the policy reads of an environment that folds its images, in order."""
        self.privileged_keys: list[Any] = [
            ("facts", name) for name in spec.network.privileged_facts or ()
        ]
        """Facts that only the value function reads."""
        self.in_keys = [*self.seen_keys, *self.privileged_keys]


class ValueAgent(Agent):
    """A policy and a value function, over one trunk or over one each."""

    def __init__(self, spec: PolicySpec, device: torch.device):
        trunk = spec.trunk(device)
        value_trunk = None if spec.network.shared else spec.trunk(device)
        super().__init__(spec, trunk)
        self.value_trunk = value_trunk
        """``None``: the value function reads the policy's."""
        self.value = Value(spec.network.hidden, len(self.privileged_keys))
