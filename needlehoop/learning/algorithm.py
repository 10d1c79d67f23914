"""What the methods of training share: an agent, Adam, the progress, and a memory of frames."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from needlehoop.learning.agent import Agent
from needlehoop.learning.encoder import Fold
from needlehoop.learning.networks import Normalizer


class Algorithm:
    """Trains an agent, one buffer after the other; a method of training derives from it.

    Args:
        agent: updated in place.
        updates: buffers until the schedules end.
        seed: decides the minibatches.
    """

    agent_class: ClassVar[type[Agent]]
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

    def remember(self, buffer: TensorDictBase) -> None:
        """Take a buffer's frames into memory, where there is one, without learning from them."""

    def _adam(self, weights: list[nn.Parameter], name: str = "all") -> torch.optim.Optimizer:
        """A new optimiser, which ``state_dict`` carries."""
        made = torch.optim.Adam(weights, self.config.learning_rate, fused=True)
        self._optimizers[name] = made
        return made

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
        for name, one in self._optimizers.items():
            one.load_state_dict(state["optimizers"][name])
        self._generator.set_state(state["generator"])
        self.done_updates = state["done_updates"]


class Memory:
    """The newest frames, on the learner's device, and minibatches of them.

    Args:
        most: frames that it holds.
        generator: draws the minibatches, on the CPU. TorchRL's own sampler wants one where the
            frames are, which would give other minibatches on a GPU.
    """

    def __init__(self, most: int, minibatch: int, device: torch.device, generator: torch.Generator):
        storage = LazyTensorStorage(most, device=device)
        self._frames = TensorDictReplayBuffer(storage=storage)
        self._minibatch, self._device, self._generator = minibatch, device, generator

    def __len__(self) -> int:
        return len(self._frames)

    def extend(self, frames: TensorDictBase) -> None:
        """Take frames ``(n,)`` in; the oldest go where there is no room."""
        self._frames.extend(frames)

    def sample(self, fold: Fold, shift: int) -> Any:
        """A minibatch, each of whose images is moved at random by up to ``shift`` pixels a way."""
        rows = torch.randint(len(self), (self._minibatch,), generator=self._generator)
        frames: Any = self._frames[rows.to(self._device)]
        for seen in (frames, frames.get("next", {})) if shift else ():
            for name, image in seen.get("pixels", {}).items():
                ways = torch.randint(-shift, shift + 1, (2, len(image)), generator=self._generator)
                seen["pixels", name] = fold.moved(image, *ways.to(image.device))
        return frames


def step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """One step down a loss's gradient."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
