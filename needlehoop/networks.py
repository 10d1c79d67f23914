"""The agent's networks: one encoder per camera, a trunk, a policy head and a value head."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.modules import (
    ActorValueOperator,
    IndependentNormal,
    ProbabilisticActor,
    ValueOperator,
)

VECTORS = ("proprio", "signals")
"""Observations that are not images, in the order in which the trunk reads them."""


@dataclass(frozen=True)
class EncoderConfig:
    """A camera's residual network; values in ``conf/encoder``."""

    name: str
    stem: int
    """Side of the blocks of pixels that become channels first; 1: none."""
    channels: tuple[int, ...]
    """Channels of each stack; every stack halves the image."""
    blocks: int
    """Residual blocks per stack."""

    def __post_init__(self) -> None:
        for key, values in (
            ("stem", (self.stem,)),
            ("channels", self.channels),
            ("blocks", (self.blocks,)),
        ):
            if not values or min(values) < 1:
                raise ValueError(f"encoder.{key}: {values} must be at least 1")

    def check_fit(self, size: int) -> None:
        """Whether square images of ``size`` px divide by the stem and outlast the stacks.

        Raises:
            ValueError: they do not.
        """
        least = self.stem * 2 ** len(self.channels)
        if size % self.stem or size < least:
            raise ValueError(
                f"image_size: {size} does not fit encoder={self.name}:"
                f" choose a multiple of {self.stem}, at least {least}"
            )


@dataclass(frozen=True)
class HeadConfig:
    """Trunk and heads; part of ``conf/algo``."""

    hidden: int
    """Width of the trunk's layers and of each encoder's output."""
    layers: int
    """Layers of the trunk."""
    sigma: float
    """Standard deviation of the first policy, in units of the action (1: its whole range)."""
    shared: bool
    """Whether the value function reads the policy's trunk; otherwise it has one of its own."""
    told: tuple[str, ...]
    """Facts that the value function is told and the policy is not."""

    def __post_init__(self) -> None:
        for key, value in (("hidden", self.hidden), ("layers", self.layers)):
            if value < 1:
                raise ValueError(f"algo.network.{key}: {value} must be at least 1")
        if not self.sigma > 0:
            raise ValueError(f"algo.network.sigma: {self.sigma} must be positive")


class Fold(nn.Module):
    """Blocks of pixels as channels: uint8 ``(..., c, h, w)`` to ``(..., h/k, w/k, k*k*c)``.

    A module of its own, channels last and still uint8, so that images are folded once when
    they are seen and not again in every epoch.
    """

    def __init__(self, stem: int):
        super().__init__()
        self._stem = stem

    def forward(self, image: Tensor) -> Tensor:
        k = self._stem
        *lead, c, h, w = image.shape
        last = image.reshape(-1, c, h, w).permute(0, 2, 3, 1).contiguous()
        blocks = last.view(-1, h // k, k, w // k, k * c).permute(0, 1, 3, 2, 4)
        return blocks.reshape(*lead, h // k, w // k, k * k * c)


class Encoder(nn.Module):
    """ML-Agents' ResNet for one camera: a folded image to float32 ``(..., out)``.

    Each stack is a 3 x 3 convolution, a max-pool that halves the image, and residual blocks
    with the activation first. A stem > 1 lets the same layers work on a smaller image.

    Args:
        shape: ``(c, h, w)`` of the camera's image.
        config: stem, channels, blocks.
        out: length of the output.
        dtype: of the convolutions; ``torch.bfloat16`` runs them under autocast.

    Raises:
        ValueError: an image that the stem does not divide or the stacks use up.
    """

    def __init__(self, shape: torch.Size, config: EncoderConfig, out: int, dtype: torch.dtype):
        super().__init__()
        channels, height, width = shape
        for side in (height, width):
            config.check_fit(side)
        stem = config.stem
        self._dtype = dtype
        layers: list[nn.Module] = []
        inner = channels * stem**2
        for width_ in config.channels:
            layers += [nn.Conv2d(inner, width_, 3, padding=1), nn.MaxPool2d(3, 2, padding=1)]
            layers += [Residual(width_) for _ in range(config.blocks)]
            inner = width_
        self.stacks = nn.Sequential(*layers, nn.SiLU())
        self.stacks.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        with torch.no_grad():
            blank = torch.zeros(1, height // stem, width // stem, channels * stem**2)
            size = self._convolve(blank).numel()
        self.dense = nn.Sequential(_linear(size, out), nn.ReLU())

    def forward(self, folded: Tensor) -> Tensor:
        flat = folded.reshape(-1, *folded.shape[-3:])
        return self.dense(self._convolve(flat)).view(*folded.shape[:-3], -1)

    def _convolve(self, folded: Tensor) -> Tensor:
        # -2 to 2, and exact in bfloat16. Centred, the first layers learn a fifth faster.
        scaled = folded.to(self._dtype).sub_(127.5).div_(64).permute(0, 3, 1, 2)
        mixed = self._dtype == torch.bfloat16
        with torch.autocast(folded.device.type, dtype=torch.bfloat16, enabled=mixed):
            return self.stacks(scaled).float().flatten(1)


class Residual(nn.Module):
    """Activation, convolution, twice; added to the input ``(n, channels, h, w)``."""

    def __init__(self, channels: int):
        super().__init__()
        self.path = nn.Sequential(
            nn.SiLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )

    def forward(self, x: Tensor) -> Tensor:
        return x + self.path(x)


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
        if self.count == 0:
            return x
        deviation = (self.square - self.mean**2).clamp(min=1e-12).sqrt()
        return ((x - self.mean) / deviation).clamp(-5.0, 5.0).float()

    def learn(self, x: Tensor) -> None:
        """Take the rows of ``x`` into account."""
        rows = x.reshape(-1, x.shape[-1]).double()
        self.count += len(rows)
        share = len(rows) / self.count
        self.mean += share * (rows.mean(0) - self.mean)
        self.square += share * ((rows**2).mean(0) - self.square)


class Trunk(nn.Module):
    """All observations to one feature vector: encoders side by side, then dense layers.

    Args:
        images: ``(c, h, w)`` by camera.
        vectors: lengths of the other observations.
        encoder: of every camera.
        heads: width and layers.
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
        size = heads.hidden * len(images) + sum(vectors.values())
        layers: list[nn.Module] = []
        for _ in range(heads.layers):
            layers += [_linear(size, heads.hidden), nn.SiLU()]
            size = heads.hidden
        self.layers = nn.Sequential(*layers)

    def forward(self, *observed: Tensor) -> Tensor:
        modules = [*self.encoders.values(), *self.normalizers.values()]
        parts = [module(value) for module, value in zip(modules, observed, strict=True)]
        return self.layers(torch.cat(parts, -1))


class Gaussian(nn.Module):
    """Policy head: a linear mean and a free deviation that no observation moves."""

    def __init__(self, inner: int, actions: int, sigma: float):
        super().__init__()
        self.mean = _linear(inner, actions, gain=0.2)
        self.log_sigma = nn.Parameter(torch.full((actions,), sigma).log())

    def forward(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        loc = self.mean(hidden)
        return loc, self.log_sigma.exp().expand_as(loc)


class Value(nn.Module):
    """Value head: linear; with facts told, a hidden layer that can weigh them by what is seen."""

    def __init__(self, inner: int, told: int):
        super().__init__()
        layers: list[nn.Module] = []
        if told:
            layers = [_linear(inner + told, inner), nn.SiLU()]
        self.layers = nn.Sequential(*layers, _linear(inner, 1))

    def forward(self, hidden: Tensor, *facts: Tensor) -> Tensor:
        return self.layers(torch.cat((hidden, *(fact.float() for fact in facts)), -1))


class Agent(TensorDictModuleBase):
    """Policy and value function over a shared trunk.

    Called with a TensorDict of observations, it writes the folded images, ``action`` (sampled or
    the mean, as TorchRL's exploration type says), its log-probability and ``state_value``.
    ``actor`` does the same without the value, for which nothing but observations is needed.

    Args:
        observed: the environment's observation spec, batch size ``(n,)``.
        actions: length of the action.
        encoder: of every camera.
        heads: trunk and heads.
        dtype: of the convolutions.

    Raises:
        ValueError: images that do not fit the encoder, or a fact that the environment lacks.
    """

    def __init__(
        self,
        observed: Composite,
        actions: int,
        encoder: EncoderConfig,
        heads: HeadConfig,
        dtype: torch.dtype,
    ):
        super().__init__()
        keys = set(observed.keys())
        pixels = observed["pixels"] if "pixels" in keys else Composite()
        images = {str(name): spec.shape[1:] for name, spec in pixels.items()}
        vectors = {name: observed[name].shape[-1] for name in VECTORS if name in keys}
        folds: list[Any] = [
            TensorDictModule(Fold(encoder.stem), [("pixels", name)], [("folded", name)])
            for name in images
        ]
        self.fold: Any = TensorDictSequential(*folds)
        trunks: list[Any] = [
            TensorDictModule(
                Trunk(images, vectors, encoder, heads, dtype),
                in_keys=[*(("folded", name) for name in images), *vectors],
                out_keys=[key],
            )
            for key in (("hidden",) if heads.shared else ("hidden", "hidden_value"))
        ]
        trunk = TensorDictSequential(*trunks)
        policy = ProbabilisticActor(
            TensorDictModule(
                Gaussian(heads.hidden, actions, heads.sigma),
                in_keys=["hidden"],
                out_keys=["loc", "scale"],
            ),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )
        facts = [("facts", name) for name in heads.told]
        known = sorted(map(str, observed["facts"].keys())) if facts else []
        for name in heads.told:
            if name not in known:
                raise ValueError(
                    f"algo.network.told: {name!r} is unknown; choose from {', '.join(known)}"
                )
        value = ValueOperator(
            Value(heads.hidden, len(facts)), in_keys=[*trunks[-1].out_keys, *facts]
        )
        self.operator = ActorValueOperator(trunk, policy, value)
        self.in_keys = [*(("pixels", name) for name in images), *vectors, *facts]
        self.out_keys = [*self.fold.out_keys, *self.operator.out_keys]

    @property
    def actor(self) -> TensorDictModuleBase:
        """The policy alone, from the same weights."""
        policy: Any = self.operator.get_policy_operator()
        return TensorDictSequential(self.fold, policy)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.operator(self.fold(tensordict))


def convolution_dtype(precision: str, device: torch.device) -> torch.dtype:
    """What ``precision`` means on a device.

    ``auto``: bfloat16 where the processor computes in it, float32 elsewhere.

    Raises:
        ValueError: an unknown precision.
    """
    if precision == "auto":
        return torch.bfloat16 if _has_bfloat16(device) else torch.float32
    if precision not in DTYPES:
        raise ValueError(
            f"precision: {precision!r} is unknown; choose from auto, {', '.join(DTYPES)}"
        )
    return DTYPES[precision]


DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}


def _has_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.cpu._is_avx512_bf16_supported()


def _linear(inner: int, out: int, gain: float = 1.0) -> nn.Linear:
    """A linear layer with ML-Agents' start: He-normal weights times ``gain``, no bias."""
    layer = nn.Linear(inner, out)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="linear")
    nn.init.zeros_(layer.bias)
    with torch.no_grad():
        layer.weight *= gain
    return layer
