"""A minibatch's gradient from its shards', added in a fixed order on threads."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from needlehoop.envs.workers import Workers

_BLOCK = 2**17
"""Numbers per block, about: 16 blocks for two cameras."""

Piece = tuple[int, slice]
"""Rows of a parameter."""


class GradientSum:
    """Writes the sum of several gradients into ``grad`` of parameters.

    The parameters are cut into blocks once, each block is one thread's; its summands are
    added in their order.

    Args:
        parameters: whose gradients are added.
        workers: to share the work.
    """

    def __init__(self, parameters: Sequence[nn.Parameter], workers: Workers):
        self._workers = workers
        self._blocks = _cut(parameters)
        self._sums = [torch.zeros_like(parameter) for parameter in parameters]
        for parameter, total in zip(parameters, self._sums, strict=True):
            parameter.grad = total

    @torch.no_grad()
    def __call__(self, gradients: Sequence[Sequence[Tensor]]) -> None:
        """Add up gradients, each with one tensor per parameter."""

        def add(block: list[Piece]) -> None:
            for index, rows in block:
                total = self._sums[index][rows]
                total.copy_(gradients[0][index][rows])
                for gradient in gradients[1:]:
                    total += gradient[index][rows]

        self._workers.map(add, self._blocks)


def _cut(parameters: Sequence[Tensor]) -> list[list[Piece]]:
    """All rows of all parameters, in blocks of about ``_BLOCK`` numbers."""
    blocks: list[list[Piece]] = [[]]
    filled = 0
    for index, parameter in enumerate(parameters):
        width = parameter[0].numel()
        step = max(1, _BLOCK // width)
        for start in range(0, len(parameter), step):
            stop = min(start + step, len(parameter))
            if filled and filled + (stop - start) * width > _BLOCK:
                blocks.append([])
                filled = 0
            blocks[-1].append((index, slice(start, stop)))
            filled += (stop - start) * width
    return blocks
