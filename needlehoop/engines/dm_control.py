"""The dm_control engine: one Environment per scene, stepped one after the other.

Slow, and the oracle of the CPU engine: the same bits by another road.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from typing import Any

import mujoco
import numpy as np
import torch
from dm_control import mujoco as dm_mujoco
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl import control
from dm_env import specs
from torch import Tensor

from needlehoop.engines.addresses import STATE, Addresses, changed_welds, varied_model, weld_data
from needlehoop.engines.contract import FIELDS
from needlehoop.engines.engine import Engine
from needlehoop.engines.quiet_start import silence_mujoco
from needlehoop.tasks.contract import Weld
from needlehoop.tasks.start import Start

mujoco.set_mju_user_warning(None)  # dm_control's prints.
silence_mujoco()


class Physics(dm_mujoco.Physics):
    """dm_control's physics, with a hint where it finds no OpenGL, and no error when it diverges."""

    @contextmanager
    def check_invalid_state(self) -> Iterator[None]:
        """Nothing is raised; the engine's ``diverged`` tells."""
        yield

    def render(self, *args: Any, **kwargs: Any) -> Any:
        """See dm_control; not what agents' cameras are drawn with.

        Raises:
            RuntimeError: no OpenGL for this process.
        """
        try:
            return super().render(*args, **kwargs)
        except (AttributeError, ImportError, mujoco.FatalError) as error:
            # What a machine without OpenGL raises, by library.
            raise RuntimeError(
                "physics.render: no OpenGL in this process; without a display, set MUJOCO_GL=egl"
                " (or osmesa) before Python starts"
            ) from error


class Servos(control.Task):
    """The scene without a task: servo commands ``(nu,)`` in, sensor data out, no end.

    Args:
        addresses: of the scene.
    """

    def __init__(self, addresses: Addresses):
        self._addresses = addresses
        self.start: Start | None = None
        """Where the next episode begins, batch size 1; ``None``: as the scene was compiled."""

    def initialize_episode(self, physics: dm_mujoco.Physics) -> None:
        if self.start is None:
            return
        data = physics.data.ptr
        data.qpos[:] = self._addresses.qpos(self.start)[0]
        data.mocap_pos[:] = self._addresses.mocap(self.start)[0]
        data.ctrl[:] = self._addresses.control(self.start)[0]

    def before_step(self, action: np.ndarray, physics: dm_mujoco.Physics) -> None:
        physics.set_control(action)

    def after_step(self, physics: dm_mujoco.Physics) -> None:
        """Bring sensors up to the present state, as far as velocities: the batch's stage."""
        mujoco.mj_step1(physics.model.ptr, physics.data.ptr)

    def action_spec(self, physics: dm_mujoco.Physics) -> specs.BoundedArray:
        return dm_mujoco.action_spec(physics)

    def get_observation(self, physics: dm_mujoco.Physics) -> OrderedDict[str, np.ndarray]:
        return OrderedDict(sensordata=physics.data.sensordata.copy())

    def get_reward(self, physics: dm_mujoco.Physics) -> float:
        return 0.0


def build_environment(
    physics: dm_mujoco.Physics, task: control.Task, substeps: int
) -> control.Environment:
    """A dm_control Environment that reads what a full step left, not what the next one begins with.

    The legacy step continues from the last refresh, blind to a weld switched since then.
    """
    return control.Environment(physics, task, n_sub_steps=substeps, legacy_step=False)


class DmControlEngine(Engine):
    """``n`` dm_control Environments, each with a copy of the scene."""

    def __init__(self, model: mujoco.MjModel, *given: Any):
        super().__init__(model, *given)
        self._tasks = [Servos(self._addresses) for _ in range(self.num_envs)]
        self.environments = [
            build_environment(Physics.from_model(MjModel(copy(model))), task, self._substeps)
            for task in self._tasks
        ]
        self._welds = self._addresses.welds

    def reset(self, ids: Tensor, start: Start) -> None:
        for row, env in enumerate(ids.tolist()):
            self._tasks[env].start = start[row : row + 1]
            self.environments[env].reset()

    def step(self, control: Tensor) -> None:
        for environment, action in zip(self.environments, control.numpy(), strict=True):
            environment.step(action)

    def diverged(self) -> Tensor:
        counts = [self._inside(env)[1].warning.number for env in range(self.num_envs)]
        return torch.from_numpy(np.stack(counts).any(1))

    def weld(self, welds: Mapping[str, Weld]) -> None:
        for name, weld in changed_welds(welds).items():
            at = self._welds[name]
            for env in weld.changed.nonzero().flatten().tolist():
                model, data = self._inside(env)
                model.eq_data[at, :10] = weld_data(weld.pose[env : env + 1].numpy())[0]
                data.eq_active[at] = bool(weld.active[env])

    def sensordata(self) -> Tensor:
        return torch.from_numpy(self._gather("sensordata"))

    def snapshot(self) -> dict[str, Tensor]:
        state = {name: torch.from_numpy(self._gather(name)) for name in STATE}
        if self._welds:
            welds = [self._inside(env)[0].eq_data for env in range(self.num_envs)]
            state["eq_data"] = torch.from_numpy(np.stack(welds))
        return state

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        for env, environment in enumerate(self.environments):
            # One that was never reset would take its next step for a reset.
            environment.reset()
            model, data = self._inside(env)
            for name in STATE:
                value = snapshot[name][env].numpy()
                setattr(data, name, value.item() if name == "time" else value)
            if self._welds:
                model.eq_data[:] = snapshot["eq_data"][env].numpy()
            self._tasks[env].after_step(environment.physics)

    def vary(self, ids: Tensor, friction: Tensor, mass: Tensor) -> None:
        varied = varied_model(self.model, friction.numpy(), mass.numpy())
        for row, env in enumerate(ids.tolist()):
            model, data = self._inside(env)
            for name, value in varied.items():
                getattr(model, name)[:] = value[row]
            mujoco.mj_setConst(model, data)

    def _drawn(self) -> Mapping[str, np.ndarray]:
        return {name: self._gather(name) for name in FIELDS}

    def data(self, env: int) -> mujoco.MjData:
        model, data = self._inside(env)
        found = copy(data)
        mujoco.mj_forward(model, found)
        return found

    def _inside(self, env: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        physics = self.environments[env].physics
        return physics.model.ptr, physics.data.ptr

    def _gather(self, name: str) -> np.ndarray:
        """A copy of one field of every MjData, ``(n, ...)`` float64."""
        rows = [getattr(self._inside(env)[1], name) for env in range(self.num_envs)]
        return np.stack(rows).astype(np.float64, copy=False)
