"""A trained policy as a function of an observation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from needlehoop.learning.agent import Actor
from needlehoop.learning.weights import Senses


class Policy:
    """``policy(observation)``: the mean action, in [-1, 1].

    An observation maps the run's cameras, and ``proprio``, ``signals`` and ``told`` where it
    had them, to numpy arrays or torch tensors, one or with any leading dimensions. Images are
    uint8, ``(..., h, w, c)`` as from Gymnasium and dm_control or ``(..., c, h, w)`` as from
    TorchRL, whose TensorDict may be given as it is. The action ``(..., action_size)`` is
    float32 and of the same kind: numpy for numpy, torch for torch.

    Args:
        origin: which policy it is, in words.
    """

    def __init__(self, senses: Senses, actor: Actor, origin: str):
        self.origin = origin
        self._actor, self._device = actor.eval(), next(actor.parameters()).device
        size = senses.image_size
        self._images = {name: (c, size, size) for name, c in senses.channels.items()}
        self._vectors = senses.vectors

    def __repr__(self) -> str:
        return f"Policy({self.origin})"

    @torch.no_grad()
    def __call__(self, observation: Mapping[str, Any]) -> Any:
        """The action.

        Raises:
            ValueError: something is missing, or of another shape or type; says what.
        """
        given = self._named(observation)
        seen = [_image(name, given[name], shape) for name, shape in self._images.items()]
        seen += [_vector(name, given[name], n) for name, n in self._vectors.items()]
        found = self._actor(*(one.to(self._device) for one in seen)).clamp(-1.0, 1.0)
        first = next(iter(given.values()))
        return found.to(first.device) if isinstance(first, Tensor) else found.cpu().numpy()

    def _named(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """What is needed of an observation, in the order of the networks."""
        keys = set(observation.keys())
        pixels = observation["pixels"] if "pixels" in keys else observation
        found = {name: pixels[name] for name in self._images if name in pixels.keys()}  # noqa: SIM118
        found |= {name: observation[name] for name in self._vectors if name in keys}
        missing = {*self._images, *self._vectors} - {*found}
        if missing:
            needed = ", ".join((*self._images, *self._vectors))
            raise ValueError(
                f"observation: {', '.join(sorted(missing))} missing; the policy sees {needed}"
            )
        return found


def _image(name: str, value: Any, first: tuple[int, int, int]) -> Tensor:
    """Channels first."""
    image = _tensor(value)
    last = (*first[1:], first[0])
    shape = tuple(image.shape[-3:])
    if image.dtype != torch.uint8 or shape not in (first, last):
        raise ValueError(
            f"{name}: {image.dtype} {tuple(image.shape)}; expected uint8 (…, {_sides(first)}) or"
            f" (…, {_sides(last)})"
        )
    if first == last:
        raise ValueError(f"{name}: as many channels as rows; no telling which are which")
    return image if shape == first else image.movedim(-1, -3)


def _vector(name: str, value: Any, length: int) -> Tensor:
    vector = _tensor(value).float()
    if vector.ndim < 1 or vector.shape[-1] != length:
        raise ValueError(f"{name}: shape {tuple(vector.shape)}; expected (…, {length})")
    return vector


def _tensor(value: Any) -> Tensor:
    # A copy of what may not be written to: torch would warn of it.
    return value if isinstance(value, Tensor) else torch.from_numpy(np.array(value))


def _sides(shape: tuple[int, ...]) -> str:
    return ", ".join(map(str, shape))
