"""The scene from the place where pictures for people are taken."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from PIL import Image

from needlehoop.engines.contract import FIELDS, Channels
from needlehoop.envs.build import PICTURE, build
from needlehoop.envs.settings import Settings


class Photographer:
    """Takes pictures of one MjData from the ``picture`` camera.

    Args:
        model: a compiled scene.
        size: pixels.
    """

    def __init__(self, model: mujoco.MjModel, size: int):
        # Imported where it is used: mujoco_warp takes two seconds.
        from needlehoop.engines.tracer import Tracer

        self._tracer = Tracer(model, 1, {PICTURE: Channels(True, False, False)}, size, 1, 2)

    def __call__(self, data: mujoco.MjData) -> np.ndarray:
        """The scene as ``(size, size, 3)`` uint8."""
        fields = {name: getattr(data, name)[None] for name in FIELDS}
        frame = self._tracer.render(fields)[PICTURE]
        assert frame.bgra is not None
        return frame.bgra[0, ..., [2, 1, 0]].numpy()


def portrait(settings: Settings, size: int) -> Image.Image:
    """The start of an episode from the ``picture`` camera.

    Args:
        settings: environment; its cameras are ignored.
        size: pixels.
    """
    simulation, _ = build(replace(settings, num_envs=1, cams=()))
    simulation.reset()
    engine = simulation.engine
    return Image.fromarray(Photographer(engine.model, size)(engine.data(0)))
