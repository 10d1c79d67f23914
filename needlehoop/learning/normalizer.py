"""Vectors, standardised."""

from __future__ import annotations

import torch
from torch import Tensor, nn


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
