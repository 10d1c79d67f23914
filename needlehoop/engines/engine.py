"""The interface of engines, which step and draw n copies of one scene, and the default engine.

An engine holds no task logic. ``Simulation`` drives it: commands in, sensor data out.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import EllipsisType
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco.batch import DATA_FIELDS, Batch
from torch import Tensor
from torch.nn.functional import pad

from needlehoop.engines.contract import FIELDS, Channels, EngineConfig, Frame, Optics
from needlehoop.engines.rasteriser.renderer import CpuRasteriser
from needlehoop.scene.image_size import ImageSize
from needlehoop.tasks.contract import Robot, Weld
from needlehoop.tasks.start import Start

_VELOCITY = int(mujoco.mjtStage.mjSTAGE_VEL)

STATE = ("time", "qpos", "qvel", "qacc_warmstart", "ctrl", "mocap_pos", "mocap_quat", "eq_active")
"""What the scene's physics depends on: it has no activations, and nothing applies forces."""

Index = int | slice | EllipsisType


def state_of(
    start: Start, model: mujoco.MjModel, pose: Callable[[np.ndarray, Start], None]
) -> dict[str, np.ndarray]:
    """``qpos`` ``(k, nq)``, ``mocap_pos`` ``(k, nmocap, 3)`` and ``ctrl`` ``(k, nu)`` of starts.

    ``pose``: the robot's ``poser`` of this model.
    """
    qpos = np.tile(model.qpos0, (len(start), 1))
    pose(qpos, start)
    for name, place in start.free.items():
        at = model.joint(name).qposadr[0]
        qpos[:, at : at + 7] = place.numpy()
    mocap = np.zeros((len(start), model.nmocap, 3))
    for name, place in start.mocap.items():
        mocap[:, model.body(name).mocapid[0]] = place.numpy()
    return {"qpos": qpos, "mocap_pos": mocap, "ctrl": start.control.numpy()}


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _ignore(message: bytes) -> None:
    pass


def silence_mujoco() -> None:
    """Keep MuJoCo from writing warnings to ``MUJOCO_LOG.TXT``: the engines read them in its data.

    A handler that the program has set already stays.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_ignore)


class Engine(ABC):
    """Physics and cameras of ``num_envs`` scenes. All tensors are on its ``device``."""

    device = torch.device("cpu")
    _renderer: Any = None
    """Its ``render`` makes images of what ``FIELDS`` say, see ``Rasteriser``."""

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: Robot,
        num_envs: int,
        substeps: int,
        config: EngineConfig,
    ):
        silence_mujoco()
        self.num_envs, self.model = num_envs, model
        self._substeps, self._threads = substeps, config.cpus
        self._pose = robot.poser(model)
        has_welds = bool((model.eq_type == mujoco.mjtEq.mjEQ_WELD).any())
        self._state = (*STATE, "eq_data") if has_welds else STATE

    def reset(self, ids: Tensor, start: Start) -> None:
        """Put environments ``ids`` ``(k,)`` at their starts (batch size k, on the CPU), and
        forward."""
        self._clear(ids)
        for name, value in state_of(start, self.model, self._pose).items():
            self.write(name, ids, torch.from_numpy(value))
        self._forward(ids)

    @abstractmethod
    def step(self, control: Tensor) -> None:
        """Advance all by one control step under ``control`` ``(n, nu)``, then forward."""

    @abstractmethod
    def diverged(self) -> Tensor:
        """Environments ``(n,)`` bool whose physics broke down since their reset.

        Such a scene is put back to where it was compiled, and goes on.
        """

    @abstractmethod
    def weld(self, welds: Mapping[str, Weld]) -> None:
        """Switch welds, by name; they act from the next step on."""

    @abstractmethod
    def read(self, name: str) -> Tensor:
        """A field ``(n, ...)`` of every MjData or MjModel."""

    @abstractmethod
    def write(self, name: str, ids: Tensor, value: Tensor, *at: Index) -> None:
        """Set a field to ``value`` ``(k, ...)`` in environments ``ids`` ``(k,)``.

        Nothing is forwarded. ``at``: index of a part of one environment's field.
        """

    def snapshot(self) -> dict[str, Tensor]:
        """The physics' whole state, as copies."""
        return {name: self.read(name).clone() for name in self._state}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Go on from a ``snapshot``, and forward."""
        ids = torch.arange(self.num_envs, device=self.device)
        for name in self._state:
            self.write(name, ids, snapshot[name])
        self._forward(ids)

    def vary(self, ids: Tensor, friction: Tensor, mass: Tensor) -> None:
        """Scale friction of all geoms, mass and inertia of free bodies, by factors ``(k,)``.

        Of the model as it was compiled; to be called before these environments' ``reset``.
        """
        model = self.model
        free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE].tolist()
        heavier = torch.ones(len(ids), model.nbody, dtype=mass.dtype, device=self.device)
        heavier[:, free] = mass.unsqueeze(-1)
        for name, factor in (
            ("geom_friction", friction[:, None, None]),
            ("body_mass", heavier),
            ("body_inertia", heavier.unsqueeze(-1)),
        ):
            # Multiplied in the engine's precision.
            here = self.read(name)
            compiled = torch.from_numpy(getattr(model, name)).to(here)
            self.write(name, ids, factor.to(here) * compiled)
        self._set_constants(ids)

    @abstractmethod
    def _clear(self, ids: Tensor) -> None:
        """Put environments ``(k,)`` back to where the scene was compiled."""

    @abstractmethod
    def _forward(self, ids: Tensor) -> None:
        """Bring environments ``(k,)`` up to their state, as far as velocities."""

    @abstractmethod
    def _set_constants(self, ids: Tensor) -> None:
        """Work out anew what a changed model of environments ``(k,)`` implies."""

    @abstractmethod
    def data(self, env: int) -> mujoco.MjData:
        """A copy of one environment's MjData, forwarded, to look at."""

    def sensordata(self) -> Tensor:
        """Sensor data ``(n, nsensordata)`` float64 at the present state; a copy."""
        return self.read("sensordata").to(torch.float64)

    def render(self, ids: Tensor | None = None, optics: Optics | None = None) -> dict[str, Frame]:
        """Frames of environments ``ids`` ``(k,)`` (all by default) by view.

        Views are chosen at construction. ``optics`` changes what is drawn, and no physics.
        """
        if self._renderer is None:
            return {}
        drawn: Mapping[str, Tensor] = {name: self.read(name) for name in FIELDS}
        return self._renderer.render(drawn if optics is None else optics(drawn), ids)


class HostEngine(Engine):
    """An engine whose state is in NumPy's arrays.

    Args:
        substeps: physics steps per control step.
        views: channels to render by view; empty for no cameras.
        size: of the images.
        quality: of the images, see ``Tracer``.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: Robot,
        num_envs: int,
        substeps: int,
        views: Mapping[str, Channels],
        size: ImageSize,
        quality: int,
        config: EngineConfig,
    ):
        super().__init__(model, robot, num_envs, substeps, config)
        if views and config.renderer == "rasteriser" and quality == 1:
            self._renderer = CpuRasteriser(model, num_envs, views, size, self._threads)
        elif views:
            # Imported where it is used: mujoco_warp takes two seconds.
            from needlehoop.engines.tracer import Tracer

            self._renderer = Tracer(model, num_envs, views, size, quality)

    def weld(self, welds: Mapping[str, Weld]) -> None:
        for name, weld in welds.items():
            ids = weld.changed.nonzero().flatten()
            if len(ids):
                at = self.model.equality(name).id
                # Anchor in the second body (its origin), the same point in the first one.
                self.write("eq_data", ids, pad(weld.pose[ids], (3, 0)), at, slice(10))
                self.write("eq_active", ids, weld.active[ids], at)


class CpuEngine(HostEngine):
    """``n`` scenes on the CPU: mujoco.batch on threads. Arguments as for ``HostEngine``."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, num_envs: int, **rest: Any):
        super().__init__(model, robot, num_envs, **rest)
        self._batch = Batch(model, num_envs, self._threads)
        # A derived field is up to date from the first call after it was bound.
        for name in ("sensordata", *(FIELDS if self._renderer else ())):
            self._batch.bind(name)

    def step(self, control: Tensor) -> None:
        self._batch.bind("ctrl")[:] = control.numpy()
        self._batch.step(nstep=self._substeps, stage=_VELOCITY)

    def diverged(self) -> Tensor:
        return torch.from_numpy(self._batch.warning.any((1, 2)))

    def data(self, env: int) -> mujoco.MjData:
        found = self._batch.get_data(env)
        mujoco.mj_forward(self._batch.get_model(env), found)
        return found

    def read(self, name: str) -> Tensor:
        # A copy, because the engine's arrays may not be writable, and torch's have to be.
        return torch.tensor(self._array(name))

    def write(self, name: str, ids: Tensor, value: Tensor, *at: Index) -> None:
        self._array(name)[(ids.numpy(), *at)] = value.numpy()

    def _array(self, name: str) -> np.ndarray:
        return self._batch.bind(name) if name in DATA_FIELDS else self._batch.expand(name)

    def _clear(self, ids: Tensor) -> None:
        self._batch.reset(ids.numpy(), stage=int(mujoco.mjtStage.mjSTAGE_NONE))

    def _forward(self, ids: Tensor) -> None:
        self._batch.forward(ids.numpy(), stage=_VELOCITY)

    def _set_constants(self, ids: Tensor) -> None:
        self._batch.set_const(ids.numpy())
