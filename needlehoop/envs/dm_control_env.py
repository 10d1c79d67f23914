"""The task as a dm_control Environment: one scene, for the viewer and for other tools.

The same task functions run here as on the CPU engine, so the two agree bit for bit.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from typing import Any

import dm_env
import numpy as np
import torch
from dm_control.rl import control
from dm_env import specs

from needlehoop.engines.dm_control import DmControlEngine, Physics
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Observer, Simulation, StepResult
from needlehoop.scene.image_size import sides


class DmControlTask(control.Task):
    """The dm_control face of a ``Simulation`` of one environment; dm_control steps its physics."""

    moment: StepResult
    """What is known now; there from the first reset on."""

    def __init__(self, simulation: Simulation):
        self.simulation, self._settings = simulation, simulation.settings
        self._observer = Observer(simulation)

    def initialize_episode(self, physics: Physics) -> None:
        self.moment = self.simulation.reset()

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        batch = torch.as_tensor(np.asarray(action, dtype=np.float64)).unsqueeze(0)
        physics.set_control(self.simulation.act(batch)[0].numpy())

    def after_step(self, physics: Physics) -> None:
        physics.refresh()
        self.moment = self.simulation.observe()

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        size = (self._settings.episode.action_size,)
        return specs.BoundedArray(size, np.float32, -1.0, 1.0, name="action")

    def observation_spec(self, physics: Physics) -> OrderedDict[str, specs.Array]:
        """Known without an observation: dm_control may ask before the first reset."""
        s = self._settings
        width, height = sides(s.image_size)
        spec: OrderedDict[str, specs.Array] = OrderedDict()
        for name, channels in s.image_channels.items():
            shape = (height, width, channels)
            spec[name] = specs.BoundedArray(shape, np.uint8, 0, 255, name)
        for name, length in s.vectors.items():
            spec[name] = specs.Array((length,), np.float32, name)
        return spec

    def get_observation(self, physics: Physics) -> OrderedDict[str, np.ndarray]:
        observed: dict[str, Any] = self._observer(self.moment.signals)
        images = observed.pop("pixels", {})
        seen = {name: image[0].permute(1, 2, 0) for name, image in images.items()}
        seen |= {name: vector[0] for name, vector in observed.items()}
        return OrderedDict((name, one.numpy()) for name, one in seen.items())

    def get_reward(self, physics: Physics) -> float:
        return float(self.moment.reward[0])

    def get_termination(self, physics: Physics) -> float | None:
        if bool(self.moment.terminated[0]):
            return 0.0
        # A time-out ends the episode but not the return: the discount stays 1.
        return 1.0 if bool(self.moment.truncated[0]) else None


def load(settings: Settings, env: int = 0) -> dm_env.Environment:
    """A dm_control Environment with the episodes of environment ``env`` of the seed.

    ``num_envs`` is ignored. Images are height x width x channels, one observation per camera. With
    nothing to observe it reports ``proprio``.
    """
    engine = replace(settings.engine, kind="dm_control")
    s = replace(settings, engine=engine, num_envs=1)
    if not (s.cams or s.vectors):
        s = replace(s, obs=replace(s.obs, proprio=True))
    simulation = build(s, first_env=env)
    assert isinstance(simulation.engine, DmControlEngine)
    task: Any = DmControlTask(simulation)
    substeps = s.episode.substeps
    return control.Environment(
        simulation.engine.physics[0], task, n_sub_steps=substeps, legacy_step=False
    )
