"""What an agent observes: stacked images, proprioception, the state."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from needlehoop.envs.settings import Observations
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.signals import Signals, columns
from needlehoop.tasks.contract import Task

VECTORS = ("proprio", "signals", "told")
"""Observations that are not images, in the order in which an agent reads them."""


def sources(task: Task, obs: Observations) -> dict[str, tuple[str, ...]]:
    """The signals of each observed vector by name, in the order of ``VECTORS``."""
    names = (task.robot.proprio * obs.proprio, task.state * obs.signals, obs.told)
    return {name: own for name, own in zip(VECTORS, names, strict=True) if own}


def vectors(task: Task, obs: Observations) -> dict[str, int]:
    """Lengths of the observed vectors by name, in the order of ``VECTORS``."""
    return {
        name: sum(task.signals[one].size for one in own) for name, own in sources(task, obs).items()
    }


def read(task: Task, obs: Observations, signals: Signals) -> dict[str, Tensor]:
    """The observed vectors, float32 ``(n, length)``, by the names of ``vectors``."""
    return {name: columns(own, signals) for name, own in sources(task, obs).items()}


class Observer:
    """Looks at a simulation the way an agent does.

    Args:
        simulation: what is looked at; its settings say with which cameras, and ``obs``.
    """

    def __init__(self, simulation: Simulation):
        self._simulation, self._obs = simulation, simulation.settings.obs
        self._has_eyes = bool(simulation.settings.cams)
        self._pixels: dict[str, Tensor] = {}

    def __call__(
        self,
        signals: Signals,
        ids: Tensor | None = None,
        images: Callable[[], dict[str, Tensor]] | None = None,
    ) -> dict[str, object]:
        """The observation of all ``n`` environments, as nested tensors by name.

        ``pixels``: ``(n, frame_stack * channels, h, w)`` uint8 by camera, oldest frame first,
        an episode's first frame repeated; and what ``read`` gives.

        Args:
            signals: current.
            ids: environments whose images are new; all by default.
            images: gives what ``look`` returned for them; by default they are made now.
        """
        seen: dict[str, object] = {}
        if self._has_eyes:
            self._take(ids, images or (lambda: self.look(ids)))
            seen["pixels"] = dict(self._pixels)
        return {**seen, **read(self._simulation.task, self._obs, signals)}

    def snapshot(self) -> dict[str, Tensor]:
        """The frames in memory, by camera."""
        return dict(self._pixels)

    def forget(self) -> None:
        """Drop the frames in memory: every episode is about to begin."""
        self._pixels = {}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Go on from a ``snapshot``."""
        self._pixels = dict(snapshot)

    def look(self, ids: Tensor | None = None) -> dict[str, Tensor]:
        """The present images of environments (all by default), by camera; none without eyes."""
        if not self._has_eyes or (ids is not None and not len(ids)):
            return {}
        return self._simulation.images(ids)

    def _take(self, ids: Tensor | None, look: Callable[[], dict[str, Tensor]]) -> None:
        images = look()
        if ids is not None and not len(ids):
            return
        if self._obs.frame_stack > 1:
            images = {name: self._stack(name, image, ids) for name, image in images.items()}
        if ids is None:
            self._pixels = images
            return
        # The previous images are in somebody's hands: new tensors, not new contents.
        self._pixels = {name: image.clone() for name, image in self._pixels.items()}
        for name, image in images.items():
            self._pixels[name][ids] = image

    def _stack(self, name: str, image: Tensor, ids: Tensor | None) -> Tensor:
        """The last ``frame_stack`` frames, the newest last."""
        assert self._simulation.state is not None
        begins = self._simulation.state["steps"] == 0
        begins = begins if ids is None else begins[ids]
        filled = image.repeat(1, self._obs.frame_stack, 1, 1)
        # Staggered episodes begin with steps used up, but without a frame in memory.
        if bool(begins.all()) or name not in self._pixels:
            return filled
        before = self._pixels[name] if ids is None else self._pixels[name][ids]
        moved = torch.cat((before[:, image.shape[1] :], image), 1)
        return torch.where(begins.view(-1, 1, 1, 1), filled, moved)
