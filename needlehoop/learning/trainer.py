"""What the methods of training share: a copy of the agent to run, Adam on threads, the progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.networks import Normalizer
from needlehoop.learning.parallel import ParallelAgent

_BLOCK = 2**17
"""Numbers per block, about: 12 blocks for two cameras."""

Piece = tuple[int, slice]
"""Rows of a parameter, by its index."""


class Trainer:
    """Trains an agent; a method of training derives from it.

    Args:
        agent: updated in place. ``running`` is a copy to act with.
        shards: parts of the agent's work on a minibatch.
        updates: buffers until the schedules end.
        seed: decides the minibatches.
        workers: to share the work; the result is the same with any number.
    """

    def __init__(self, agent: Agent, shards: int, updates: int, seed: int, workers: Workers):
        self.agent, self.updates = agent, updates
        self.done_updates = 0
        # A GPU needs no parts.
        parts = shards if next(agent.parameters()).device.type == "cpu" else 1
        self.running = ParallelAgent(agent.computing(), parts, workers)
        self._workers = workers
        self._optimizer = self._new_optimizer()
        self._generator = torch.Generator().manual_seed(seed)

    def _new_optimizer(self) -> Optimizer:
        copies = list(self.running.agent.parameters())
        return Optimizer(list(self.agent.parameters()), copies, self._workers)

    def _end_update(self, buffer: TensorDictBase) -> None:
        """After the last minibatch of a buffer."""
        for path, module in self.agent.named_modules():
            # Each trunk has one of its own for each vector, by its name.
            if isinstance(module, Normalizer):
                module.learn(buffer[path.rpartition(".")[2]])
        self.running.agent.follow(self.agent)
        self.done_updates += 1

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides the next update, except the frames kept of earlier buffers."""
        return {
            "agent": self.agent.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "generator": self._generator.get_state(),
            "done_updates": self.done_updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self.agent.load_state_dict(state["agent"])
        self.running.agent.follow(self.agent)
        self._optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self.done_updates = state["done_updates"]


class Optimizer:
    """Adam, whose weights are cut into blocks that threads share.

    How they are cut depends on their shapes alone, and so does what comes of it.

    Args:
        weights: what is learnt, float32.
        copies: of the same shapes, in types to compute in; they follow the weights.
    """

    def __init__(
        self, weights: Sequence[nn.Parameter], copies: Sequence[nn.Parameter], workers: Workers
    ):
        self._workers = workers
        self._blocks = [_Block(weights, copies, pieces) for pieces in _cut(weights)]

    def set_rate(self, rate: float) -> None:
        for block in self._blocks:
            block.adam.param_groups[0]["lr"] = rate

    def step(self, gradient: Callable[[int, slice, Tensor], None]) -> None:
        """Move weights and copies; ``gradient`` writes rows of a weight's, by its index."""
        self._workers.map(lambda block: block.step(gradient), self._blocks)

    def state_dict(self) -> list[dict[str, Any]]:
        """Adam's state, by block."""
        return [block.adam.state_dict() for block in self._blocks]

    def load_state_dict(self, state: list[dict[str, Any]]) -> None:
        """Go on from a ``state_dict``."""
        for block, own in zip(self._blocks, state, strict=True):
            block.adam.load_state_dict(own)


class _Block:
    """A few rows of the weights."""

    def __init__(
        self,
        weights: Sequence[nn.Parameter],
        copies: Sequence[nn.Parameter],
        pieces: list[Piece],
    ):
        self._pieces = pieces
        self._copies = [copies[index].detach()[rows] for index, rows in pieces]
        self._weights = [nn.Parameter(weights[index].detach()[rows]) for index, rows in pieces]
        for weight in self._weights:
            weight.grad = torch.zeros_like(weight)
        self.adam = torch.optim.Adam(self._weights, fused=True)
        # As Adam would at its first step: a state has the same keys before it and after.
        for weight in self._weights:
            zeros = {key: torch.zeros_like(weight) for key in ("exp_avg", "exp_avg_sq")}
            self.adam.state[weight] = {"step": torch.zeros((), device=weight.device), **zeros}

    @torch.no_grad()
    def step(self, gradient: Callable[[int, slice, Tensor], None]) -> None:
        for (index, rows), weight in zip(self._pieces, self._weights, strict=True):
            assert weight.grad is not None
            gradient(index, rows, weight.grad)
        self.adam.step()
        for copied, weight in zip(self._copies, self._weights, strict=True):
            copied.copy_(weight)


def _cut(weights: Sequence[Tensor]) -> list[list[Piece]]:
    """All rows of all weights, in blocks of about ``_BLOCK`` numbers."""
    blocks: list[list[Piece]] = [[]]
    filled = 0
    for index, weight in enumerate(weights):
        width = weight[0].numel()
        step = max(1, _BLOCK // width)
        for start in range(0, len(weight), step):
            rows = slice(start, min(start + step, len(weight)))
            size = (rows.stop - rows.start) * width
            if filled and filled + size > _BLOCK:
                blocks.append([])
                filled = 0
            blocks[-1].append((index, rows))
            filled += size
    return blocks
