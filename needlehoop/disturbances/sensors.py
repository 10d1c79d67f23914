"""The sensors of the cameras, which add flaws to what they see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from needlehoop.disturbances.axes import Drawn
from needlehoop.disturbances.kernel import EDGE, SPARE, Flaw, spoil
from needlehoop.engines import warp_device
from needlehoop.engines.contract import Frame
from needlehoop.engines.warp_device import start_warp
from needlehoop.scene.image_size import ImageSize, sides

_PERIOD = 2**18
"""Number of offsets in the noise tables at which an image's noise may start."""

Spoiler = Callable[[str, Frame, slice], None]
"""Changes a view's contiguous frames in place; the slice says which rows of a batch they are."""


def flaws(drawn: Mapping[str, Drawn]) -> dict[str, Tensor]:
    """The fields of ``Flaw`` for pictures ``(k, views)``, from what was drawn for each axis.

    Exposure, contrast and white balance act one after the other, on colours alone.
    """
    share = {name: drawn[f"picture.{name}"].amount for name in ("brightness", "contrast", "cast")}
    same = {"blur": "blur", "noise": "noise", "labels": "flips"}
    same |= {name: name for name in ("depth_noise", "depth_step")}
    cover, cast = drawn["picture.cover"], 1.0 + share["cast"]
    # Contrast leaves this grey as it is.
    grey = 128.0
    return {
        **{field: drawn[f"picture.{name}"].amount[..., 0] for name, field in same.items()},
        "gain": (1.0 + share["brightness"]) * (1.0 + share["contrast"]) * cast,
        "bias": -grey * share["contrast"] * cast,
        "drop": torch.cat((cover.amount, cover.free), -1),
    }


class Sensors:
    """Sensors of all views. Noise is cut out of two tables that never change.

    Each picture is spoilt by one thread: a GPU spoils all pictures of a view at once.
    """

    def __init__(
        self, num_envs: int, views: tuple[str, ...], size: ImageSize, device: torch.device
    ):
        start_warp()
        self._views, self._device = views, device
        width, height = sides(size)
        self._size = wp.vec2i(width, height)
        shape, generator = (num_envs, len(views)), np.random.default_rng(0)
        kind: Any = Flaw
        warp = wp.device_from_torch(device)
        self._host_flaws = wp.zeros(shape, dtype=kind, device="cpu")
        self._flaws = wp.zeros(shape, dtype=kind, device=warp)
        self._fields: Any = self._host_flaws.numpy()
        self._starts = torch.zeros(*shape, 3, dtype=torch.int32, device=device)
        count = _PERIOD + 4 * width * height
        tables = (
            generator.standard_normal(count, dtype=np.float32),
            generator.random(count, dtype=np.float32),
        )
        self._normal, self._uniform = (torch.from_numpy(one).to(device) for one in tables)
        room = (height + SPARE) * (4 * width + 2 * EDGE)
        # Threads of a GPU run at the same time; the CPU's Warp runs them one after the other.
        self._stride = 0 if device.type == "cpu" else room
        self._room = room if device.type == "cpu" else num_envs * room
        # The first launch compiles: before any other thread launches.
        no = torch.zeros(0, dtype=torch.int64, device=device)
        self.spoiler(no, torch.zeros(0, 3))(views[0], Frame(None, None, None), slice(0, 0))

    def set(self, ids: Tensor, **flaws: Tensor) -> None:
        """Give the pictures of environments ``(k,)`` values ``(k, views, …)`` of ``Flaw``.

        All of them on the CPU.
        """
        for name, values in flaws.items():
            self._fields[name][ids.numpy()] = values.numpy()
        with warp_device.on(self._device):
            wp.copy(self._flaws, self._host_flaws)

    def spoiler(self, ids: Tensor, places: Tensor) -> Spoiler:
        """A function that adds flaws to the frames of environments ``ids`` ``(k,)``.

        ``places`` ``(k, views * 3)``: where their noise begins, in [0, 1).
        """
        begins = (places * _PERIOD).to(self._starts)
        self._starts[ids] = begins.reshape(len(ids), len(self._views), 3)
        envs = ids.int()

        def run(view: str, frame: Frame, part: slice) -> None:
            scratch = torch.empty(self._room, device=self._device)
            inputs = [
                *(wp.from_torch(envs), part.start, self._views.index(view), self._flaws),
                wp.from_torch(self._starts, dtype=wp.vec3i),
                *(self._normal.data_ptr(), self._uniform.data_ptr()),
                *(scratch.data_ptr(), self._stride),
                *(0 if one is None else one.data_ptr() for one in frame),
                self._size,
            ]
            with warp_device.on(self._device):
                wp.launch(spoil, dim=part.stop - part.start, inputs=inputs)

        return run
