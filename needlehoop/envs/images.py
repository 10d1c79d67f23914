"""Images as agents see them: rendered frames turned into uint8 channels."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from operator import or_
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.config.strict import check_names
from needlehoop.disturbances.sensors import Spoiler
from needlehoop.engines.contract import Channels, Frame
from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import Camera, Rendering, View
from needlehoop.tasks.contract import FlatClass

DARKEST = 0.15
"""Brightness at the far end of a depth-shaded image; 1 at the near end."""

_FEWEST, _MOST = 5, 20
"""Images that a thread composes at once. Fewer cost more in calls than in work; more do not fit
the CPU's cache."""


class Imager:
    """Composes the images of the chosen cameras; any number of threads gives the same bits.

    On the device of the engine; a GPU composes all at once. Raises ``ValueError`` where a flat
    rendering names a class that there is not.
    """

    def __init__(self, model: mujoco.MjModel, settings: Settings, threads: int):
        device = settings.engine.torch_device
        self._threads, self._most = threads, _MOST
        if device.type == "cuda":
            self._threads, self._most = 1, settings.num_envs
        # OpenMP's number of threads holds for each thread by itself: let each compute alone.
        alone = {"initializer": torch.set_num_threads, "initargs": (1,)}
        pool = self._threads > 1
        self._map: Any = ThreadPoolExecutor(self._threads, **alone).map if pool else map
        s, paint = settings, settings.definition.paint
        self._jobs = [(c, s.views[c.view], s.renderings[c.rendering]) for c in s.cameras]
        self.views = {camera.name: camera.view for camera in s.cameras}
        self._palettes = {
            camera.rendering: _palette(model, paint, rendering).to(device)
            for camera, _, rendering in self._jobs
            if rendering.colour == "flat"
        }

    def __call__(
        self, frames: Mapping[str, Frame], spoil: Spoiler | None = None
    ) -> dict[str, Tensor]:
        """Images ``(n, channels, h, w)`` uint8 by camera name, of frames by view.

        ``spoil``: adds flaws to the frames first.
        """
        images = {}
        for camera, _, rendering in self._jobs:
            channel = next(x for x in frames[camera.view] if x is not None)
            count, height, width = channel.shape[:3]
            shape = (count, rendering.channels, height, width)
            images[camera.name] = torch.empty(shape, dtype=torch.uint8, device=channel.device)

        def compose(rows: slice) -> None:
            seen = {
                name: Frame(*(x if x is None else x[rows] for x in frame))
                for name, frame in frames.items()
            }
            if spoil is not None:
                for name, frame in seen.items():
                    spoil(name, frame, rows)
            for camera, view, rendering in self._jobs:
                images[camera.name][rows] = self._image(camera, view, rendering, seen[camera.view])

        count = max(map(len, images.values()), default=0)
        size = min(max(-(-count // self._threads), _FEWEST), self._most)
        list(self._map(compose, (slice(at, min(at + size, count)) for at in range(0, count, size))))
        return images

    def _image(self, camera: Camera, view: View, rendering: Rendering, frame: Frame) -> Tensor:
        parts = []
        if rendering.colour == "rgb":
            assert frame.bgra is not None
            parts.append(torch.stack([frame.bgra[..., channel] for channel in (2, 1, 0)], 1))
        elif rendering.colour == "flat":
            assert frame.geom is not None
            # Nothing hit is -1: the palette's first, black entry.
            entries, shape = (frame.geom + 1).flatten(), frame.geom.shape
            palette = self._palettes[camera.rendering]
            planes = [plane.index_select(0, entries).view(shape) for plane in palette]
            parts.append(torch.stack(planes, 1))
        if rendering.depth != "none":
            assert frame.depth is not None
            # 1 at the view's near depth, 0 at its far depth and where nothing was hit.
            nearness = ((view.far - frame.depth) / (view.far - view.near)).clamp(0.0, 1.0)
            nearness = torch.where(frame.depth > 0, nearness, torch.zeros_like(nearness))
            nearness = nearness.unsqueeze(1)
            if rendering.depth == "channel":
                parts.append((255 * nearness).round().to(torch.uint8))
            else:
                shade = DARKEST + (1 - DARKEST) * nearness
                parts = [(parts[0] * shade).round().to(torch.uint8)]
        return torch.cat(parts, 1)


def channels_of(settings: Settings) -> dict[str, Channels]:
    """The channels that each view needs for its cameras: a view is rendered once."""
    channels: dict[str, Channels] = {}
    for camera in settings.cameras:
        style = settings.renderings[camera.rendering]
        needs = Channels(style.colour == "rgb", style.depth != "none", style.colour == "flat")
        channels[camera.view] = Channels(*map(or_, needs, channels.get(camera.view, needs)))
    return channels


def _palette(
    model: mujoco.MjModel, classes: Mapping[str, FlatClass], rendering: Rendering
) -> Tensor:
    """Colour planes ``(3, 1 + ngeom)``: black, then by geom id."""
    check_names("rendering.colours", [*rendering.colours], [*classes])
    palette = torch.zeros(3, 1 + model.ngeom, dtype=torch.uint8)
    for name, colour in rendering.colours.items():
        numbers = torch.from_numpy(things(model, {name: classes[name]}))
        palette[:, 1:][:, numbers == 1] = torch.tensor(colour, dtype=torch.uint8).unsqueeze(1)
    return palette


def things(model: mujoco.MjModel, classes: Mapping[str, FlatClass]) -> np.ndarray:
    """Number of the class that each geom belongs to ``(ngeom,)``, from 1 on; 0 for the rest."""
    numbers = np.zeros(model.ngeom, int)
    for number, flat in enumerate(classes.values(), 1):
        members = np.zeros(model.nbody, bool)
        members[[model.body(body).id for body in flat.bodies]] = True
        # A body comes after the one that it hangs on.
        for body, parent in enumerate(model.body_parentid):
            members[body] |= members[parent]
        numbers[members[model.geom_bodyid]] = number
    return numbers
