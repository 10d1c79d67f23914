"""The network of a probe: the agent's encoders and trunk, trained to read facts off frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from needlehoop.config.strict import Count, Range
from needlehoop.learning.encoder import EncoderConfig, Fold
from needlehoop.learning.networks import HeadConfig, Trunk
from needlehoop.probe.frames import Frames

_STATE = "signals"


@dataclass(frozen=True)
class Fit:
    """How the network is trained; values in ``conf/probe.yaml``."""

    updates: Count
    minibatch: Count
    learning_rate: Annotated[float, Range(0.0, 10.0, above=True)]
    """Of Adam at the start; falls to zero in a straight line."""


@dataclass(frozen=True)
class Reading:
    """The answers for ``m`` frames: ``points`` and ``fact`` as in ``Frames``."""

    points: Tensor
    fact: Tensor


class Reader:
    """The agent's encoders and trunk, with a linear layer that gives the answers.

    Weights are drawn here, from torch's global generator; ``learn`` draws from its own.

    Args:
        frames: to learn from, folded by ``fold``.
        cameras: whose images are read; none: the true state is.
        encoder: of every camera.
        heads: width and layers of the trunk.
        dtype: of the convolutions.
        device: where it is trained.
    """

    def __init__(
        self,
        frames: Frames,
        cameras: Sequence[str],
        encoder: EncoderConfig,
        heads: HeadConfig,
        dtype: torch.dtype,
        device: torch.device,
    ):
        self._cameras, self._device = tuple(cameras), device
        # Trunk takes unfolded shapes: (c, h, w).
        images = {name: _unfolded(frames.images[name].shape[1:], encoder.stem) for name in cameras}
        vectors = {} if cameras else {_STATE: frames.state.shape[-1]}
        trunk = Trunk(images, vectors, encoder, heads, dtype)
        self._trunk = trunk.to(device)
        self._mean = frames.points.mean(0)
        self._answers = nn.Linear(heads.hidden, self._mean.numel() + 1).to(device)
        self._normalizers: list[Any] = list(trunk.normalizers.values())
        self._deviation = frames.points.std(0).clamp(min=1e-3)

    def learn(self, frames: Frames, fit: Fit, seed: int, tick: Callable[[], object]) -> None:
        """Train on frames, in minibatches drawn by ``seed``; ``tick`` is called after each."""
        for normalizer in self._normalizers:
            normalizer.learn(frames.state.to(self._device))
        wanted = ((frames.points - self._mean) / self._deviation).flatten(1)
        weights = [*self._trunk.parameters(), *self._answers.parameters()]
        optimizer = torch.optim.Adam(weights, lr=fit.learning_rate)
        falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, fit.updates)
        generator = torch.Generator().manual_seed(seed)
        for _ in range(fit.updates):
            rows = torch.randint(len(frames), (fit.minibatch,), generator=generator)
            said = self._say(frames, rows)
            loss = functional.mse_loss(said[:, :-1], wanted[rows].to(self._device))
            loss = loss + functional.binary_cross_entropy_with_logits(
                said[:, -1], frames.fact[rows].float().to(self._device)
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            falling.step()
            tick()

    @torch.no_grad()
    def read(self, frames: Frames) -> Reading:
        """Read frames that were not learnt from."""
        parts = [self._say(frames, rows).cpu() for rows in torch.arange(len(frames)).split(512)]
        said = torch.cat(parts)
        points = said[:, :-1].view(-1, *self._mean.shape) * self._deviation + self._mean
        return Reading(points, said[:, -1] > 0)

    def _say(self, frames: Frames, rows: Tensor) -> Tensor:
        """Standardised points and, last, the logit of the fact, of chosen frames."""
        values = [frames.images[name] for name in self._cameras] or [frames.state]
        return self._answers(self._trunk(*(value[rows].to(self._device) for value in values)))


def fold(frames: Frames, stem: int) -> Frames:
    """Frames with their images folded for an encoder: once, for all readers."""
    folder = Fold(stem)
    images = {name: folder(image) for name, image in frames.images.items()}
    return replace(frames, images=images)


def _unfolded(shape: torch.Size, stem: int) -> torch.Size:
    height, width, channels = shape
    return torch.Size((channels // stem**2, height * stem, width * stem))
