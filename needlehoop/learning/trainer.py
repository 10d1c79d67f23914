"""What the methods of training share: a copy of the agent to run, Adam, and the progress."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.networks import Normalizer
from needlehoop.learning.optimizer import Optimizer
from needlehoop.learning.parallel import ParallelAgent


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
        # Each trunk has one of its own for each vector.
        self._normalizers = [
            (path.rpartition(".")[2], module)
            for path, module in agent.named_modules()
            if isinstance(module, Normalizer)
        ]
        self._generator = torch.Generator().manual_seed(seed)

    def _new_optimizer(self) -> Optimizer:
        copies = list(self.running.agent.parameters())
        return Optimizer(list(self.agent.parameters()), copies, self._workers)

    def _step(self, slopes: Sequence[Tensor]) -> None:
        """One step of the optimiser, from the gradients by the agent's outputs."""
        self.running.backward(slopes)
        self._optimizer.step(self._write)

    def _write(self, weight: int, rows: slice, out: Tensor) -> None:
        """Write rows of a weight's gradient."""
        self.running.write(weight, rows, out)

    def _end_update(self, buffer: TensorDictBase) -> None:
        """After the last minibatch of a buffer."""
        for name, normalizer in self._normalizers:
            normalizer.learn(buffer[name])
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
