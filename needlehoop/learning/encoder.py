"""An encoder: one camera's image to a feature vector, in the numbers that suit the processor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor, nn

from needlehoop.config.strict import OneOf, Range, check_names
from needlehoop.scene.image_size import ImageSize, extent, sides


@dataclass(frozen=True)
class EncoderConfig:
    """A camera's residual network; values in ``conf/encoder``."""

    name: str
    stem: Annotated[int, Range(1, 64)]
    """Side of the blocks of pixels that become channels first; 1: none."""
    channels: tuple[Annotated[int, Range(1, 4096)], ...]
    """Channels of each stack; every stack halves the image."""
    blocks: Annotated[int, Range(1, 64)]
    """Residual blocks per stack."""
    halving: Annotated[str, OneOf("pool", "stride")] = "pool"
    """How a stack halves the image: by a max-pool after its convolution, as ML-Agents does, or by
    a convolution of stride 2."""

    def check_fit(self, size: ImageSize) -> None:
        """Raises ``ValueError`` where images of this size do not fit stem and stacks."""
        least = self.stem * 2 ** len(self.channels)
        if any(side % self.stem or side < least for side in sides(size)):
            raise ValueError(
                f"image_size: {extent(size)} does not fit encoder={self.name}:"
                f" choose a multiple of {self.stem}, at least {least}"
            )


class Fold(nn.Module):
    """Blocks of pixels as channels: uint8 ``(..., c, h, w)`` to ``(..., h/k, w/k, k*k*c)``.

    A module of its own, so that images are folded once when they are seen, not in every epoch.
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

    def moved(self, folded: Tensor, down: Tensor, right: Tensor) -> Tensor:
        """Folded images ``(n, h/k, w/k, k*k*c)``, each moved by whole pixels; edges are repeated.

        ``down`` and ``right`` ``(n,)``: by how many; negative values move up and left.
        """
        k = self._stem
        n, rows, columns, size = folded.shape

        def sources(side: int, moves: Tensor) -> Tensor:
            pixels = torch.arange(side * k, device=folded.device)
            return (pixels - moves[:, None]).clamp(0, side * k - 1).view(n, side, k)

        y, x = sources(rows, down), sources(columns, right)
        # The position of each source pixel, counted image by image and block by block.
        above = (y // k * columns * k + y % k) * k
        beside = x // k * k * k + x % k
        first = torch.arange(n, device=folded.device) * (rows * columns * k * k)
        at = first.view(n, 1, 1, 1, 1) + above[:, :, None, :, None] + beside[:, None, :, None, :]
        pixels = folded.reshape(-1, size // k**2)
        return pixels.index_select(0, at.flatten()).view_as(folded)


class Encoder(nn.Module):
    """ML-Agents' ResNet for one camera: a folded image to float32 ``(..., out)``.

    Each stack is a 3 x 3 convolution that halves the image, by a max-pool or its stride, and
    residual blocks with the activation first. ``shape``: ``(c, h, w)`` of the camera's image.
    ``dtype``: of the products; ``torch.bfloat16`` runs them under autocast.
    """

    def __init__(self, shape: torch.Size, config: EncoderConfig, out: int, dtype: torch.dtype):
        super().__init__()
        channels, height, width = shape
        config.check_fit((width, height))
        stem, inner = config.stem, channels * config.stem**2
        self._is_mixed = dtype == torch.bfloat16
        self._centre: Tensor
        self.register_buffer("_centre", torch.tensor(-127.5 / 64, dtype=dtype), persistent=False)
        blank = torch.zeros(1, height // stem, width // stem, inner)
        layers: list[nn.Module] = []
        for outer in config.channels:
            if config.halving == "stride":
                layers += [nn.Conv2d(inner, outer, 3, stride=2, padding=1)]
            else:
                layers += [nn.Conv2d(inner, outer, 3, padding=1), nn.MaxPool2d(3, 2, padding=1)]
            layers += [Residual(outer) for _ in range(config.blocks)]
            inner = outer
        self.stacks = nn.Sequential(*layers, nn.SiLU())
        self.stacks.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        with torch.no_grad(), self._precision("cpu"):
            size = self._convolve(blank).numel()
        self.dense = nn.Sequential(linear(size, out), nn.ReLU())

    def forward(self, folded: Tensor) -> Tensor:
        flat = folded.reshape(-1, *folded.shape[-3:])
        with self._precision(folded.device.type):
            features = self.dense(self._convolve(flat)).float()
        return features.view(*folded.shape[:-3], -1)

    def _precision(self, device: str) -> torch.autocast:
        return torch.autocast(device, dtype=torch.bfloat16, enabled=self._is_mixed)

    def _convolve(self, folded: Tensor) -> Tensor:
        # (x - 127.5) / 64 in one pass: -2 to 2, and exact in bfloat16. Centred, the first layers
        # learn a fifth faster.
        image = folded.to(self._centre.dtype).permute(0, 3, 1, 2)
        maps = self.stacks(torch.add(self._centre, image, alpha=1 / 64))
        # Channels last, as they lie in memory: nothing is copied.
        return maps.permute(0, 2, 3, 1).flatten(1)


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


def linear(inner: int, out: int, gain: float = 1.0) -> nn.Linear:
    """A linear layer with ML-Agents' start: He-normal weights times ``gain``, no bias."""
    layer = nn.Linear(inner, out)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="linear")
    nn.init.zeros_(layer.bias)
    with torch.no_grad():
        layer.weight *= gain
    return layer


def convolution_dtype(precision: str, device: torch.device) -> torch.dtype:
    """What ``precision`` means on a device; ``auto``: bfloat16 where the processor has it."""
    check_names("precision", [precision], ("auto", "fp32", "bf16"))
    if precision != "auto":
        is_fast = precision == "bf16"
    elif device.type == "cuda":
        is_fast = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        is_fast = torch.cpu._is_avx512_bf16_supported()
    return torch.bfloat16 if is_fast else torch.float32
