"""Noise that leads an expert astray, so that it shows how to come back."""

from __future__ import annotations

import torch
from torch import Tensor

_MEMORY = 0.7
"""Share of the noise that stays from step to step, so that it leads somewhere."""


class Perturbation:
    """Correlated noise on actions, of another strength in every episode.

    Args:
        num_envs: environments.
        size: length of the action.
        strongest: strengths are uniform up to this, in units of the action.
        generator: draws it.
    """

    def __init__(self, num_envs: int, size: int, strongest: float, generator: torch.Generator):
        self._strongest, self._generator = strongest, generator
        self._drift = torch.zeros(num_envs, size, dtype=torch.float64)
        self._strength = torch.zeros(num_envs, 1, dtype=torch.float64)
        self.begin(torch.ones(num_envs, dtype=torch.bool))

    def begin(self, mask: Tensor) -> None:
        """Draw a new strength, and forget the noise, where ``mask`` ``(n,)`` is true."""
        fresh = self._strongest * self._draw(*self._strength.shape)
        self._strength = torch.where(mask.unsqueeze(-1), fresh, self._strength)
        self._drift = torch.where(mask.unsqueeze(-1), 0.0, self._drift)

    def __call__(self) -> Tensor:
        """This step's noise ``(n, size)``, float64."""
        self._drift = _MEMORY * self._drift + 2.0 * self._draw(*self._drift.shape) - 1.0
        return self._strength * self._drift

    def snapshot(self) -> dict[str, Tensor]:
        """What decides the next noise, but for the generator."""
        return {"drift": self._drift, "strength": self._strength}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Go on from a ``snapshot``."""
        self._drift, self._strength = snapshot["drift"], snapshot["strength"]

    def _draw(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self._generator, dtype=torch.float64)
