"""The sensors of the cameras, which add flaws to what they see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
import warp as wp

from needlehoop.disturbances.axes import Drawn
from needlehoop.disturbances.kernel import EDGE, SPARE, Flaw, spoil
from needlehoop.engines.contract import Frame
from needlehoop.engines.quiet_start import start_warp

_PERIOD = 2**18
"""Places in the tables of noise at which an image's may begin."""

Spoiler = Callable[[str, Frame, slice], None]
"""Changes a view's frames of some rows of a batch, and takes those rows."""


def flaws(drawn: Mapping[str, Drawn]) -> dict[str, np.ndarray]:
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
        "drop": np.concatenate((cover.amount, cover.free), -1),
    }


class Sensors:
    """Sensors of all views ``size`` px wide. Noise is cut out of two tables that never change."""

    def __init__(self, num_envs: int, views: tuple[str, ...], size: int):
        start_warp()
        self._views, self._size = views, size
        shape, generator = (num_envs, len(views)), np.random.default_rng(0)
        kind: Any = Flaw
        self._flaws = wp.zeros(shape, dtype=kind, device="cpu")
        self._fields: Any = self._flaws.numpy()
        self._starts = wp.zeros(shape, dtype=wp.vec3i, device="cpu")
        count = _PERIOD + 4 * size**2
        self._normal = generator.standard_normal(count, dtype=np.float32)
        self._uniform = generator.random(count, dtype=np.float32)
        # The first launch compiles: before any other thread launches.
        no = np.zeros(0, int)
        self.spoiler(no, np.zeros((0, 3)))(views[0], Frame(None, None, None), slice(0, 0))

    def set(self, ids: np.ndarray, **flaws: np.ndarray) -> None:
        """Give the pictures of environments ``(k,)`` values ``(k, views, …)`` of ``Flaw``."""
        for name, values in flaws.items():
            self._fields[name][ids] = values

    def spoiler(self, ids: np.ndarray, places: np.ndarray) -> Spoiler:
        """A function that adds flaws to the frames of environments ``ids`` ``(k,)``.

        ``places`` ``(k, views * 3)``: where their noise begins, in [0, 1).
        """
        self._starts.numpy()[ids] = (places * _PERIOD).reshape(len(ids), len(self._views), 3)
        envs, side = wp.array(ids, dtype=int, device="cpu"), self._size

        def run(view: str, frame: Frame, part: slice) -> None:
            channels = [one if one is None else one.contiguous() for one in frame]
            scratch = torch.empty(side + SPARE, 4 * side + 2 * EDGE)
            inputs = [
                *(envs, part.start, self._views.index(view), self._flaws, self._starts),
                *(self._normal.ctypes.data, self._uniform.ctypes.data, scratch.data_ptr()),
                *(0 if one is None else one.data_ptr() for one in channels),
                side,
            ]
            wp.launch(spoil, dim=part.stop - part.start, inputs=inputs, device="cpu")
            # The tracer's are not contiguous.
            for given, one in zip(frame, channels, strict=True):
                if given is not None and one is not None and one is not given:
                    given.copy_(one)

        return run
