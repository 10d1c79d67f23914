"""The same cameras through MuJoCo's own OpenGL renderer: what benchmarks compare with."""

from __future__ import annotations

import os
from dataclasses import replace

import mujoco
import numpy as np
import torch

# dm_control picks its OpenGL library when it is imported; without a display it picks one that
# needs a display.
os.environ.setdefault("MUJOCO_GL", "egl")

import dm_env

from needlehoop.engines.contract import Frame
from needlehoop.envs.dm_control_env import load
from needlehoop.envs.images import Imager, channels_of
from needlehoop.envs.settings import Settings
from needlehoop.envs.workers import Workers


class OpenGLEnvironment:
    """Environment ``env`` of the seed in dm_control, with images from MuJoCo's default renderer.

    ``num_envs`` of the settings is ignored.
    """

    def __init__(self, settings: Settings, env: int = 0):
        self._size = settings.image_size
        self.environment = load(replace(settings, cams=()), env)
        self._physics = self.environment.physics
        self._imager = Imager(self._physics.model.ptr, settings, Workers(1))
        self._asked = channels_of(settings)

    def reset(self) -> dict[str, np.ndarray]:
        """Begin an episode; images ``(c, h, w)`` uint8 by camera."""
        self.environment.reset()
        return self._look()

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], dm_env.TimeStep]:
        """Images after an action, and what dm_control says."""
        moment = self.environment.step(action)
        return self._look(), moment

    def _look(self) -> dict[str, np.ndarray]:
        frames = {}
        for view, asked in self._asked.items():
            bgra = depth = geom = None
            if asked.colour:
                colour = self._render(view)
                alpha = np.full_like(colour[..., :1], 255)
                bgra = torch.from_numpy(np.concatenate((colour[..., ::-1], alpha), -1)[None])
            if asked.depth:
                depth = torch.from_numpy(self._render(view, depth=True).copy()[None])
            if asked.geom:
                # Pairs of object id and object type.
                found = self._render(view, segmentation=True)
                ids = np.where(found[..., 1] == mujoco.mjtObj.mjOBJ_GEOM, found[..., 0], -1)
                geom = torch.from_numpy(ids.astype(np.int32)[None])
            frames[view] = Frame(bgra, depth, geom)
        return {name: image[0].numpy() for name, image in self._imager(frames).items()}

    def _render(self, view: str, **kind: bool) -> np.ndarray:
        return self._physics.render(self._size, self._size, camera_id=view, **kind)
