"""What an agent observes: stacked images, proprioception, the state."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from needlehoop.envs.images import Imager
from needlehoop.envs.settings import Observations, Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.signals import PROPRIO_SIZE, Signals, proprio

STATE_SIGNALS = (
    "tool_midpoint",
    "pickup_point",
    "needle_tip",
    "goal",
    "lift_position",
    "needle_quat",
    "joints",
    "jaw",
    "jaw_command",
    "grasped",
    "lifted",
)
"""What ``signals`` concatenates: enough to do the task without eyes."""

STATE_SIZE = 29
"""Their numbers."""


VECTORS = ("proprio", "signals", "told")
"""Observations that are not images, in the order in which an agent reads them."""


def vectors(obs: Observations) -> dict[str, int]:
    """Lengths of the observed vectors by name, in the order of ``VECTORS``."""
    lengths = (PROPRIO_SIZE * obs.proprio, STATE_SIZE * obs.signals, len(obs.told))
    return {name: length for name, length in zip(VECTORS, lengths, strict=True) if length}


def read(obs: Observations, signals: Signals) -> dict[str, Tensor]:
    """The observed vectors, float32 ``(n, length)``, by the names of ``vectors``."""
    made = {"proprio": proprio, "signals": state, "told": partial(_beside, obs.told)}
    return {name: made[name](signals) for name in vectors(obs)}


class Observer:
    """Looks at a simulation the way an agent does.

    Args:
        settings: cameras, ``obs``.
        simulation: what is looked at.
        imager: composes the cameras' images.
    """

    def __init__(self, settings: Settings, simulation: Simulation, imager: Imager):
        self._obs, self._has_eyes = settings.obs, bool(settings.cams)
        self._simulation, self._imager = simulation, imager
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
        return {**seen, **read(self._obs, signals)}

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
        return self._imager(self._simulation.engine.render(ids))

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
        begins = self._simulation.state.steps == 0
        begins = begins if ids is None else begins[ids]
        filled = image.repeat(1, self._obs.frame_stack, 1, 1)
        # Staggered episodes begin with steps used up, but without a frame in memory.
        if bool(begins.all()) or name not in self._pixels:
            return filled
        before = self._pixels[name] if ids is None else self._pixels[name][ids]
        moved = torch.cat((before[:, image.shape[1] :], image), 1)
        return torch.where(begins.view(-1, 1, 1, 1), filled, moved)


def state(signals: Signals) -> Tensor:
    """``STATE_SIGNALS`` side by side, float32 ``(n, STATE_SIZE)``."""
    return _beside(STATE_SIGNALS, signals)


def _beside(names: tuple[str, ...], signals: Signals) -> Tensor:
    """Named signals side by side, float32."""
    columns = []
    for name in names:
        value = getattr(signals, name).float()
        columns.append(value if value.ndim == 2 else value.unsqueeze(-1))
    return torch.cat(columns, -1)
