"""The agent's networks, put together: policy and value function.

There are three ways to run them:

- ``Agent``: everything in one piece, from prepared observations to mean, deviation and value.
  ``parallel.ParallelAgent`` does the same in parts on threads, with gradients. Training uses it.
- ``Actor``: the policy alone, from observations to the mean action. Evaluations use it, and it is
  what ``policy.safetensors`` holds.
- ``policy.Policy``: an ``Actor`` for users. It takes named observations, in NumPy or torch, and
  checks them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn

from needlehoop.learning.encoder import Encoder, EncoderConfig, Fold
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk, Value


class Actor(nn.Module):
    """The policy's part of an agent: observations to the mean action, on plain tensors."""

    def __init__(self, fold: Fold, trunk: Trunk, head: Gaussian):
        super().__init__()
        self._images = len(trunk.encoders)
        self.fold, self.trunk, self.head = fold, trunk, head

    def forward(self, *observed: Tensor) -> Tensor:
        """The mean ``(..., action_size)`` of images ``(..., c, h, w)`` uint8, then vectors."""
        images, vectors = observed[: self._images], observed[self._images :]
        loc, _ = self.head(self.trunk(*(self.fold(image) for image in images), *vectors))
        return loc


class Agent(nn.Module):
    """Policy and value function over a shared trunk.

    Args:
        images: ``(c, h, w)`` by camera.
        vectors: lengths of the other observations.
        dtype: of the convolutions.

    Raises:
        ValueError: images that do not fit the encoder.
    """

    def __init__(
        self,
        images: Mapping[str, torch.Size],
        vectors: Mapping[str, int],
        actions: int,
        encoder: EncoderConfig,
        heads: HeadConfig,
        dtype: torch.dtype,
    ):
        super().__init__()
        told = heads.told or ()
        self.fold = Fold(encoder.stem)
        self.trunks = nn.ModuleList(
            Trunk(images, vectors, encoder, heads, dtype) for _ in range(1 if heads.shared else 2)
        )
        self.gaussian = Gaussian(heads.hidden, actions, heads.sigma)
        self.value = Value(heads.hidden, len(told))
        self._images, self._vectors = len(images), len(vectors)
        rest: list[Any] = [*vectors, *(("facts", name) for name in told)]
        self.in_keys = [*(("pixels", name) for name in images), *rest]
        """Of what an environment reports, in the order in which it is read."""
        self.seen_keys = [*(("folded", name) for name in images), *rest]
        """The same, of what a buffer keeps: images are folded."""

    @property
    def actor(self) -> Actor:
        """The policy alone: the same modules, so loading weights into it loads them here too."""
        trunk: Any = self.trunks[0]
        return Actor(self.fold, trunk, self.gaussian)

    def computing(self) -> Agent:
        """A copy with the encoders' weights in the type that they compute in.

        It gives the same outputs without converting a weight; ``follow`` brings it up to date.
        """
        copied = deepcopy(self)
        for module in copied.modules():
            if isinstance(module, Encoder):
                module.to(module.dtype)
        return copied

    @torch.no_grad()
    def follow(self, agent: Agent) -> None:
        """Take over another agent's weights and statistics; types of numbers stay."""
        pairs = zip(
            (*self.parameters(), *self.buffers()),
            (*agent.parameters(), *agent.buffers()),
            strict=True,
        )
        for own, other in pairs:
            own.copy_(other)

    @property
    def encoders(self) -> list[Encoder]:
        """One per camera; those of the value function's own trunk after the policy's."""
        trunks: Any = self.trunks
        return [encoder for trunk in trunks for encoder in trunk.encoders.values()]

    def prepare(self, *observed: Tensor) -> list[Tensor]:
        """Observations in the order of ``in_keys``, images folded: that of ``seen_keys``."""
        return [*map(self.fold, observed[: self._images]), *observed[self._images :]]

    def forward(self, *seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """``loc``, ``scale`` and ``state_value`` of what ``prepare`` gives."""
        images, rest = seen[: self._images], seen[self._images :]
        features = [encoder(images[at % self._images]) for at, encoder in enumerate(self.encoders)]
        return self.conclude(features, rest)

    def conclude(
        self, features: Sequence[Tensor], rest: Sequence[Tensor]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The part of ``forward`` after the ``encoders``, of their outputs in their order.

        Args:
            rest: what follows the images in ``seen_keys``.
        """
        vectors, facts = rest[: self._vectors], rest[self._vectors :]
        trunks: Any = self.trunks
        hidden = [
            trunk.merge(features[i * self._images : (i + 1) * self._images], vectors)
            for i, trunk in enumerate(trunks)
        ]
        return *self.gaussian(hidden[0]), self.value(hidden[-1], *facts)
