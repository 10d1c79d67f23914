"""What an agent observes: stacked images, proprioception, the state."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.envs.settings import Observations, sources
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.signals import Signals, columns
from needlehoop.tasks.contract import Task


def read(task: Task, obs: Observations, signals: Signals) -> dict[str, Tensor]:
    """The observed vectors, float32 ``(n, length)``, by the names of ``vectors``."""
    return {name: columns(own, signals) for name, own in sources(task, obs).items()}


class Observer:
    """Looks at a simulation the way an agent does, as its settings say."""

    def __init__(self, simulation: Simulation):
        self._simulation, self._obs = simulation, simulation.settings.obs
        self.pixels: dict[str, Tensor] = {}
        """The frames in memory, by camera; to be emptied where every episode is about to begin."""

    def __call__(
        self,
        signals: Signals,
        ids: Tensor | None = None,
        images: dict[str, Tensor] | None = None,
    ) -> dict[str, object]:
        """The observation of all ``n`` environments, as nested tensors by name.

        ``pixels``: ``(n, frame_stack * channels, h, w)`` uint8 by camera, oldest frame first,
        an episode's first frame repeated; and what ``read`` gives. ``ids``: environments whose
        images are new (all by default). ``images``: what ``look`` returned for them, if it did.
        """
        new = self.look(ids) if images is None else images
        if self._obs.frame_stack > 1:
            new = {name: self._stack(name, image, ids) for name, image in new.items()}
        if ids is None:
            self.pixels = new
        elif new:
            # Callers may still hold the previous images.
            self.pixels = {name: image.clone() for name, image in self.pixels.items()}
            for name, image in new.items():
                self.pixels[name][ids] = image
        seen: dict[str, object] = {"pixels": dict(self.pixels)} if self.pixels else {}
        return {**seen, **read(self._simulation.task, self._obs, signals)}

    def look(self, ids: Tensor | None = None) -> dict[str, Tensor]:
        """The present images of environments (all by default), by camera."""
        if not self._simulation.settings.cams or (ids is not None and not len(ids)):
            return {}
        return self._simulation.images(ids)

    def _stack(self, name: str, image: Tensor, ids: Tensor | None) -> Tensor:
        """The last ``frame_stack`` frames, the newest last."""
        begins = self._simulation.state["steps"] == 0
        begins = begins if ids is None else begins[ids]
        filled = image.repeat(1, self._obs.frame_stack, 1, 1)
        # Staggered episodes begin with steps used up, but without a frame in memory.
        if bool(begins.all()) or name not in self.pixels:
            return filled
        before = self.pixels[name] if ids is None else self.pixels[name][ids]
        moved = torch.cat((before[:, image.shape[1] :], image), 1)
        return torch.where(begins.view(-1, 1, 1, 1), filled, moved)
