"""The CPU engine: mujoco.batch on all cores."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from needlehoop.engines.addresses import STATE, changed_welds, varied_model, weld_data
from needlehoop.engines.contract import FIELDS
from needlehoop.engines.engine import Engine
from needlehoop.tasks.contract import Robot, Weld
from needlehoop.tasks.start import Start

_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)


class CpuEngine(Engine):
    """``n`` scenes on the CPU: mujoco.batch on threads."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, num_envs: int, *given: Any):
        super().__init__(model, robot, num_envs, *given)
        self._batch = Batch(model, num_envs, self._threads)
        self._sensordata = self._batch.bind("sensordata")
        self._scratch_data: mujoco.MjData | None = None
        self._scratch_model: mujoco.MjModel | None = None
        self._fields = {name: self._batch.bind(name) for name in FIELDS if self._renderer}
        if self._addresses.welds:
            self._weld_data = self._batch.expand("eq_data")
            self._weld_active = self._batch.bind("eq_active")

    def reset(self, ids: Tensor, start: Start) -> None:
        rows, batch = ids.numpy(), self._batch
        batch.reset(rows, stage=_NOTHING)
        batch.bind("qpos")[rows] = self._addresses.qpos(start)
        batch.bind("mocap_pos")[rows] = self._addresses.mocap(start)
        batch.bind("ctrl")[rows] = self._addresses.control(start)
        batch.forward(rows, stage=_VELOCITY)

    def step(self, control: Tensor) -> None:
        self._batch.bind("ctrl")[:] = control.numpy()
        self._batch.step(nstep=self._substeps, stage=_VELOCITY)

    def diverged(self) -> Tensor:
        return torch.from_numpy(self._batch.warning.any((1, 2)))

    def weld(self, welds: Mapping[str, Weld]) -> None:
        for name, weld in changed_welds(welds).items():
            at, rows = self._addresses.welds[name], weld.changed.nonzero().flatten().numpy()
            self._weld_data[rows, at, :10] = weld_data(weld.pose[weld.changed].numpy())
            self._weld_active[rows, at] = weld.active[weld.changed].double().numpy()

    def sensordata(self) -> Tensor:
        return torch.tensor(self._sensordata)

    def snapshot(self) -> dict[str, Tensor]:
        state = {name: torch.tensor(self._batch.bind(name)) for name in STATE}
        if self._addresses.welds:
            state["eq_data"] = torch.tensor(self._weld_data)
        return state

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        for name in STATE:
            self._batch.bind(name)[:] = snapshot[name].numpy()
        if self._addresses.welds:
            self._weld_data[:] = snapshot["eq_data"].numpy()
        self._batch.forward(stage=_VELOCITY)

    def vary(self, ids: Tensor, friction: Tensor, mass: Tensor) -> None:
        rows = ids.numpy()
        varied = varied_model(self.model, friction.numpy(), mass.numpy())
        for name, value in varied.items():
            self._batch.expand(name)[rows] = value
        self._batch.set_const(rows)

    def _drawn(self) -> Mapping[str, np.ndarray]:
        return self._fields

    def data(self, env: int) -> mujoco.MjData:
        self._scratch_data = self._batch.get_data(env, self._scratch_data)
        self._scratch_model = self._batch.get_model(env, self._scratch_model)
        mujoco.mj_forward(self._scratch_model, self._scratch_data)
        return self._scratch_data
