"""The dm_control engine: one dm_control physics per scene, stepped one after the other.

It is slow, and checks the CPU engine: both give the same bits.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from copy import copy
from typing import Any

import mujoco
import numpy as np
import torch
from dm_control import mujoco as dm_mujoco
from dm_control.mujoco.wrapper import MjModel
from torch import Tensor

from needlehoop.engines.engine import HostEngine, Index, silence_mujoco

mujoco.set_mju_user_warning(None)  # dm_control's prints.
silence_mujoco()


class Physics(dm_mujoco.Physics):
    """dm_control's physics, without an error when it diverges."""

    def check_invalid_state(self) -> AbstractContextManager[None]:
        """Raises nothing: the engine's ``diverged`` tells."""
        return nullcontext()

    def refresh(self) -> None:
        """Compute sensors of the present state, as far as velocities."""
        mujoco.mj_step1(self.model.ptr, self.data.ptr)


class DmControlEngine(HostEngine):
    """``n`` scenes in dm_control, each with a copy of the model; arguments as in ``HostEngine``."""

    def __init__(self, model: mujoco.MjModel, **rest: Any):
        super().__init__(model, **rest)
        self.physics = [Physics.from_model(MjModel(copy(model))) for _ in range(self.num_envs)]
        """Of each environment."""
        for physics in self.physics:
            # The legacy step would not see a weld that was switched since the last refresh.
            physics.legacy_step = False

    def step(self, control: Tensor) -> None:
        for physics, command in zip(self.physics, control.numpy(), strict=True):
            physics.set_control(command)
            physics.step(self._substeps)
            physics.refresh()

    def diverged(self) -> Tensor:
        counts = [physics.data.ptr.warning.number for physics in self.physics]
        return torch.from_numpy(np.stack(counts).any(1))

    def data(self, env: int) -> mujoco.MjData:
        found = copy(self.physics[env].data.ptr)
        mujoco.mj_forward(self.physics[env].model.ptr, found)
        return found

    def write(self, name: str, ids: Tensor, value: Tensor, *at: Index) -> None:
        for env, new in zip(ids.tolist(), value.numpy(), strict=True):
            if name == "time":
                self.physics[env].data.ptr.time = new
            else:
                getattr(self._owner(env, name), name)[at or ...] = new

    def read(self, name: str) -> Tensor:
        rows = [getattr(self._owner(env, name), name) for env in range(self.num_envs)]
        # As mujoco.batch has them.
        return torch.from_numpy(np.stack(rows).astype(np.float64, copy=False))

    def _clear(self, ids: Tensor) -> None:
        for env in ids.tolist():
            self.physics[env].reset()

    def _forward(self, ids: Tensor) -> None:
        for env in ids.tolist():
            self.physics[env].refresh()

    def _set_constants(self, ids: Tensor) -> None:
        for env in ids.tolist():
            mujoco.mj_setConst(self.physics[env].model.ptr, self.physics[env].data.ptr)

    def _owner(self, env: int, name: str) -> Any:
        """The MjModel or the MjData of an environment, whichever has the field."""
        model, data = self.physics[env].model.ptr, self.physics[env].data.ptr
        return data if hasattr(data, name) else model
