"""What the methods of training share: an agent, Adam, progress, and a memory of frames."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from needlehoop.learning.networks import Agent, Normalizer, PolicySpec

_RAMP = 30
"""Minibatches over which ``MemoryAlgorithm`` warms up the learning rate."""


class Algorithm:
    """Trains an agent, one buffer after the other; a method of training derives from it.

    The agent is updated in place. ``updates``: buffers until the schedules end. ``seed``: decides
    the minibatches.
    """

    agent_class: ClassVar[Callable[[PolicySpec, torch.device], Agent]]
    policy: TensorDictModuleBase
    """Acts in the environments."""

    def __init__(self, agent: Any, config: Any, updates: int, seed: int):
        self.agent, self.config, self.updates = agent, config, updates
        self.device = next(agent.parameters()).device
        self.done_updates = 0
        self._optimizers: dict[str, torch.optim.Optimizer] = {}
        self._generator = torch.Generator().manual_seed(seed)

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        """Learn from a buffer ``(num_envs, horizon)``; returns what is reported, as means."""
        raise NotImplementedError

    def _adam(self, weights: list[nn.Parameter], name: str = "all") -> None:
        """Make an optimiser, which ``state_dict`` carries."""
        self._optimizers[name] = torch.optim.Adam(weights, self.config.learning_rate, fused=True)

    def _end_update(self, buffer: TensorDictBase) -> None:
        """After the last minibatch of a buffer."""
        for path, module in self.agent.named_modules():
            # The path of a normaliser ends in the name of its vector.
            if isinstance(module, Normalizer):
                module.learn(buffer[path.rpartition(".")[2]])
        self.done_updates += 1

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides the next update, except the frames kept of earlier buffers."""
        return {
            "agent": self.agent.state_dict(),
            "optimizers": {name: one.state_dict() for name, one in self._optimizers.items()},
            "generator": self._generator.get_state(),
            "done_updates": self.done_updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self.agent.load_state_dict(state["agent"])
        for name, optimizer in self._optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])
        self._generator.set_state(state["generator"])
        self.done_updates = state["done_updates"]


class MemoryAlgorithm(Algorithm):
    """Learns from the newest frames of all buffers so far, after each new buffer."""

    def __init__(self, agent: Any, config: Any, updates: int, seed: int):
        super().__init__(agent, config, updates, seed)
        # It would say into the progress bar that it makes room.
        logging.getLogger("torchrl").setLevel(logging.WARNING)
        storage = LazyTensorStorage(config.memory, device=self.device)
        self._frames = TensorDictReplayBuffer(storage=storage)

    def _kept(self, buffer: TensorDictBase) -> TensorDictBase:
        """What the memory keeps of a buffer."""
        raise NotImplementedError

    def _learn(self) -> dict[str, Tensor]:
        """Learn from a minibatch; returns what is reported of it."""
        raise NotImplementedError

    def _pace(self, share: float) -> float:
        """Of the learning rate, what is left after a share of all minibatches."""
        raise NotImplementedError

    def remember(self, buffer: TensorDictBase) -> None:
        """Take a buffer's frames into memory; the oldest go where there is no room."""
        self._frames.extend(self._kept(buffer).reshape(-1))

    def update(self, buffer: TensorDictBase) -> dict[str, float]:
        self.remember(buffer)
        totals, count = Counter[str](), self.config.minibatches
        for done in range(self.done_updates * count, (self.done_updates + 1) * count):
            rate = self.config.learning_rate * self._pace(done / (self.updates * count))
            for optimizer in self._optimizers.values():
                optimizer.param_groups[0]["lr"] = rate * min(1.0, (done + 1) / _RAMP)
            totals.update(self._learn())
        self._end_update(buffer)
        return {
            **{name: float(value) / count for name, value in totals.items()},
            "frames": float(len(self._frames)),
            "learning_rate": next(iter(self._optimizers.values())).param_groups[0]["lr"],
        }

    def _minibatch(self) -> Any:
        """Frames drawn at random; images are moved by up to ``picture_shift`` pixels a way.

        All is drawn on the CPU, so that a GPU learns from the same minibatches.
        """
        rows = torch.randint(len(self._frames), (self.config.minibatch,), generator=self._generator)
        frames: Any = self._frames[rows.to(self.device)]
        shift = self.config.picture_shift
        for seen in (frames, frames.get("next", {})) if shift else ():
            for name, image in seen.get("pixels", {}).items():
                ways = torch.randint(-shift, shift + 1, (2, len(image)), generator=self._generator)
                seen["pixels", name] = self.agent.actor.fold.moved(image, *ways.to(image.device))
        return frames


def step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """One step down a loss's gradient."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
