"""The agent's networks beyond the encoders: a trunk, a policy head and a value head."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor, nn

from needlehoop.config.strict import Names, Range
from needlehoop.learning.encoder import Encoder, EncoderConfig, linear


@dataclass(frozen=True)
class HeadConfig:
    """Trunk and heads; part of ``conf/algo``."""

    hidden: Annotated[int, Range(1, 16_384)]
    """Width of the trunk's layers and of each encoder's output."""
    layers: Annotated[int, Range(1, 64)]
    """Layers of the trunk."""
    sigma: Annotated[float, Range(0.0, 100.0, above=True)]
    """Standard deviation of the first policy, in units of the action (1: its whole range)."""
    shared: bool
    """Whether the value function reads the policy's trunk; otherwise it has one of its own."""
    told: Names | None
    """Facts that the value function is told and the policy is not; ``None``: the task's choice."""
    squash: bool = False
    """Whether a tanh keeps actions within their range."""


class Normalizer(nn.Module):
    """Standardises vectors ``(..., size)`` by the mean and variance of all it was shown.

    The statistics are part of the state dict. They move in ``learn`` alone, so a vector
    looks the same while it is collected and while it is learnt from.
    """

    count: Tensor
    mean: Tensor
    square: Tensor

    def __init__(self, size: int):
        super().__init__()
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("square", torch.zeros(size, dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:
        deviation = (self.square - self.mean**2).clamp(min=1e-12).sqrt()
        standard = ((x - self.mean) / deviation).clamp(-5.0, 5.0).float()
        # Not a branch of Python, which an exporter could not follow.
        return torch.where(self.count == 0, x.float(), standard)

    def learn(self, x: Tensor) -> None:
        """Take the rows of ``x`` into account."""
        rows = x.reshape(-1, x.shape[-1]).double()
        self.count += len(rows)
        share = len(rows) / self.count
        self.mean += share * (rows.mean(0) - self.mean)
        self.square += share * ((rows**2).mean(0) - self.square)


def dense(size: int, heads: HeadConfig) -> list[nn.Module]:
    """The layers of a trunk, from so many inputs to ``heads.hidden`` features."""
    layers: list[nn.Module] = []
    for _ in range(heads.layers):
        layers += [linear(size, heads.hidden), nn.SiLU()]
        size = heads.hidden
    return layers


class Trunk(nn.Module):
    """All observations to one feature vector: encoders side by side, then dense layers.

    Args:
        images: ``(c, h, w)`` by camera.
        vectors: lengths of the other observations.
        dtype: of the convolutions.
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
        self.encoders = nn.ModuleDict(
            {name: Encoder(shape, encoder, heads.hidden, dtype) for name, shape in images.items()}
        )
        self.normalizers = nn.ModuleDict({name: Normalizer(n) for name, n in vectors.items()})
        self.size = heads.hidden * len(images) + sum(vectors.values())
        self.layers = nn.Sequential(*dense(self.size, heads))

    def forward(self, *observed: Tensor) -> Tensor:
        return self.layers(self.see(*observed))

    def see(self, *observed: Tensor) -> Tensor:
        """What the dense layers read ``(..., size)``: the encoders' outputs, then vectors."""
        count = len(self.encoders)
        pairs = zip(self.encoders.values(), observed[:count], strict=True)
        parts = [encoder(image) for encoder, image in pairs]
        own = zip(self.normalizers.values(), observed[count:], strict=True)
        parts += [normalizer(vector) for normalizer, vector in own]
        return torch.cat(parts, -1)


class Gaussian(nn.Module):
    """Policy head: a linear mean and a state-independent deviation, squashed by a tanh or not."""

    def __init__(self, inner: int, actions: int, sigma: float, squash: bool):
        super().__init__()
        self._squash = squash
        self.mean = linear(inner, actions, gain=0.2)
        self.log_sigma = nn.Parameter(torch.full((actions,), sigma).log())

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
    """Value head: linear; with facts told, a hidden layer that can weigh them by what is seen."""

    def __init__(self, inner: int, told: int):
        super().__init__()
        weighing = [linear(inner + told, inner), nn.SiLU()] if told else []
        self.layers = nn.Sequential(*weighing, linear(inner, 1))

    def forward(self, hidden: Tensor, *facts: Tensor) -> Tensor:
        return self.layers(torch.cat((hidden, *(fact.float() for fact in facts)), -1))
