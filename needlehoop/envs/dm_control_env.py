"""The task as a dm_control Environment: one scene, for the viewer and for other tools.

The same task functions run here as on the CPU engine, so the two agree bit for bit.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import dm_env
import mujoco
import numpy as np
import torch
from dm_control import mujoco as dm_mujoco
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl import control
from dm_env import specs
from torch import Tensor

from needlehoop import rewards
from needlehoop.engines.addresses import Addresses, weld_data, weld_index
from needlehoop.engines.contract import FIELDS, Channels, EngineConfig, Frame
from needlehoop.engines.renderers import make_renderer
from needlehoop.envs.images import Imager, channels_of
from needlehoop.envs.observer import STATE_SIZE, Observer
from needlehoop.envs.settings import Settings, compile_scene
from needlehoop.envs.simulation import Moment, Simulation
from needlehoop.scene.signals import PROPRIO_SIZE, proprio
from needlehoop.task.facts import Weld
from needlehoop.task.start import Start

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class PhysicsEngine:
    """A dm_control Physics as an engine of one environment; see ``contract.Engine``.

    Args:
        physics: the scene.
        substeps: physics steps per control step.
        views: channels to render by view.
        size: image width and height, px.
        quality: see ``Tracer``.
        config: renderer; there is one thread.
    """

    num_envs = 1

    def __init__(
        self,
        physics: dm_mujoco.Physics,
        substeps: int,
        views: dict[str, Channels],
        size: int,
        quality: int,
        config: EngineConfig,
    ):
        self._physics, self._substeps = physics, substeps
        self.model: mujoco.MjModel = physics.model.ptr
        self._addresses = Addresses(self.model)
        self._renderer = (
            make_renderer(config.renderer, self.model, 1, views, size, 1, quality)
            if views
            else None
        )
        self._weld = weld_index(self.model)

    def reset(self, ids: Tensor, start: Start) -> None:
        data = self._physics.data.ptr
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self._addresses.qpos(start)[0]
        data.mocap_pos[:] = self._addresses.mocap(start)[0]
        data.ctrl[:] = self._addresses.control(start)[0]
        self.refresh()

    def step(self, control: Tensor) -> None:
        self.command(control)
        self._physics.step(self._substeps)
        self.refresh()

    def command(self, control: Tensor) -> None:
        """Set the servos without stepping: dm_control steps the physics itself."""
        self._physics.set_control(control[0].numpy())

    def refresh(self) -> None:
        """Bring sensors up to the present state, as far as velocities: the batch's stage."""
        mujoco.mj_step1(self.model, self._physics.data.ptr)

    def weld(self, weld: Weld) -> None:
        if self._weld is None or not bool(weld.changed.any()):
            return
        self.model.eq_data[self._weld, :10] = weld_data(weld.pose.numpy())[0]
        self._physics.data.ptr.eq_active[self._weld] = bool(weld.active[0])

    def sensordata(self) -> Tensor:
        return torch.from_numpy(self._physics.data.ptr.sensordata.copy()).unsqueeze(0)

    def snapshot(self) -> dict[str, Tensor]:
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self._physics.data.ptr, state, _STATE)
        return {"state": torch.from_numpy(state), "eq_data": torch.tensor(self.model.eq_data)}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        state = snapshot["state"].numpy()
        mujoco.mj_setState(self.model, self._physics.data.ptr, state, _STATE)
        self.model.eq_data[:] = snapshot["eq_data"].numpy()
        self.refresh()

    def render(self, ids: Tensor | None = None) -> dict[str, Frame]:
        if self._renderer is None:
            return {}
        data = self._physics.data.ptr
        return self._renderer.render({name: getattr(data, name)[None] for name in FIELDS})


class NeedleHoopTask(control.Task):
    """The dm_control face of a ``Simulation``; its physics is stepped by dm_control."""

    def __init__(self, simulation: Simulation, imager: Imager, settings: Settings):
        self.simulation, self._settings = simulation, settings
        self._observer = Observer(settings, simulation, imager)
        self.moment: Moment | None = None

    @property
    def _engine(self) -> PhysicsEngine:
        engine = self.simulation.engine
        assert isinstance(engine, PhysicsEngine)
        return engine

    def initialize_episode(self, physics: dm_mujoco.Physics) -> None:
        self.moment = self.simulation.reset()

    def before_step(self, action: np.ndarray, physics: dm_mujoco.Physics) -> None:
        given = torch.as_tensor(np.asarray(action, dtype=np.float64)).unsqueeze(0)
        self._engine.command(self.simulation.act(given))

    def after_step(self, physics: dm_mujoco.Physics) -> None:
        self._engine.refresh()
        self.moment = self.simulation.observe()

    def action_spec(self, physics: dm_mujoco.Physics) -> specs.BoundedArray:
        size = self._settings.episode.action_size
        return specs.BoundedArray((size,), np.float32, -1.0, 1.0, name="action")

    def observation_spec(self, physics: dm_mujoco.Physics) -> OrderedDict[str, specs.Array]:
        """Known without an observation: dm_control may ask before the first reset."""
        s = self._settings
        found: OrderedDict[str, specs.Array] = OrderedDict()
        for name, channels in s.image_channels.items():
            shape = (s.image_size, s.image_size, channels)
            found[name] = specs.BoundedArray(shape, np.uint8, 0, 255, name)
        if s.obs.proprio or not (s.cams or s.obs.signals):
            found["proprio"] = specs.Array((PROPRIO_SIZE,), np.float32, "proprio")
        if s.obs.signals:
            found["signals"] = specs.Array((STATE_SIZE,), np.float32, "signals")
        return found

    def get_observation(self, physics: dm_mujoco.Physics) -> OrderedDict[str, np.ndarray]:
        signals = self._known().signals
        observed = self._observer(signals)
        images: Any = observed.pop("pixels", {})
        seen = OrderedDict(
            (name, image[0].permute(1, 2, 0).numpy()) for name, image in images.items()
        )
        for name, vector in observed.items():
            assert isinstance(vector, Tensor)
            seen[name] = vector[0].numpy()
        return seen or OrderedDict(proprio=proprio(signals)[0].numpy())

    def get_reward(self, physics: dm_mujoco.Physics) -> float:
        return float(self._known().reward[0])

    def get_termination(self, physics: dm_mujoco.Physics) -> float | None:
        moment = self._known()
        if bool(moment.terminated[0]):
            return 0.0
        # A time-out ends the episode but not the return: the discount stays 1.
        return 1.0 if bool(moment.truncated[0]) else None

    def _known(self) -> Moment:
        if self.moment is None:
            raise RuntimeError("reset before the first step")
        return self.moment


def load(settings: Settings, env: int = 0) -> dm_env.Environment:
    """A dm_control Environment.

    Its episodes are those of environment ``env`` of a batch with the same seed. Images
    are height x width x channels, one observation per chosen camera; without cameras it
    reports ``proprio``.

    Args:
        settings: what to build; ``num_envs`` is ignored.
        env: which of the seed's environments.

    Raises:
        ValueError: settings that do not go together, by key.
    """
    s, cameras = settings, settings.cameras
    physics = dm_mujoco.Physics.from_model(MjModel(compile_scene(s)))
    imager = Imager(physics.model.ptr, cameras, s.views, s.renderings)
    views = channels_of(cameras, s.renderings)
    engine = PhysicsEngine(physics, s.episode.substeps, views, s.image_size, s.quality, s.engine)
    reward = rewards.load(s.reward)
    simulation = Simulation(engine, s.task, s.episode, reward, s.seed, first_env=env)
    task: Any = NeedleHoopTask(simulation, imager, s)
    # The legacy step continues from the last refresh, blind to a weld switched since then.
    return control.Environment(physics, task, n_sub_steps=s.episode.substeps, legacy_step=False)
