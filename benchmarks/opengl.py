"""The same cameras through MuJoCo's own OpenGL renderer: what benchmarks compare with."""

import os
from dataclasses import replace
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch

# dm_control picks its OpenGL library when it is imported; without a display it picks one that
# needs a display.
os.environ.setdefault("MUJOCO_GL", "egl")

from gymnasium import spaces

from needlehoop.engines.contract import Frame
from needlehoop.envs.dm_control_env import load
from needlehoop.envs.images import Imager, channels_of
from needlehoop.envs.settings import Settings
from needlehoop.scene.image_size import sides


class OpenGLEnvironment(gymnasium.Env):
    """Environment ``env`` of the seed in dm_control, with images from MuJoCo's default renderer.

    Images are ``(c, h, w)`` uint8 by camera. ``num_envs`` of the settings is ignored.
    """

    def __init__(self, settings: Settings, env: int = 0):
        self._sides = width, height = sides(settings.image_size)
        self._environment = load(replace(settings, cams=()), env)
        self._physics = self._environment.physics
        self._imager = Imager(self._physics.model.ptr, settings, 1)
        self._channels = channels_of(settings)
        images: dict[str, spaces.Space] = {}
        for camera in settings.cameras:
            shape = (settings.renderings[camera.rendering].channels, height, width)
            images[camera.name] = spaces.Box(0, 255, shape, np.uint8)
        self.observation_space = spaces.Dict(images)
        self.action_space = spaces.Box(-1.0, 1.0, (settings.episode.action_size,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._environment.reset()
        return self._look(), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        moment = self._environment.step(action)
        over = moment.last()
        terminated = over and moment.discount == 0.0
        return self._look(), float(moment.reward), terminated, over and not terminated, {}

    def _look(self) -> dict[str, np.ndarray]:
        frames = {}
        for view, channels in self._channels.items():
            bgra = depth = geom = None
            if channels.colour:
                colour = self._render(view)
                alpha = np.full_like(colour[..., :1], 255)
                bgra = torch.from_numpy(np.concatenate((colour[..., ::-1], alpha), -1)[None])
            if channels.depth:
                depth = torch.from_numpy(self._render(view, depth=True).copy()[None])
            if channels.geom:
                # Pairs of object id and object type.
                pairs = self._render(view, segmentation=True)
                ids = np.where(pairs[..., 1] == mujoco.mjtObj.mjOBJ_GEOM, pairs[..., 0], -1)
                geom = torch.from_numpy(ids.astype(np.int32)[None])
            frames[view] = Frame(bgra, depth, geom)
        return {name: image[0].numpy() for name, image in self._imager(frames).items()}

    def _render(self, view: str, **kind: bool) -> np.ndarray:
        width, height = self._sides
        return self._physics.render(height, width, camera_id=view, **kind)
