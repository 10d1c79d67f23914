"""The Warp engine: mujoco_warp steps all scenes at once, and they are drawn on the same device.

Its state is float32 in Warp's arrays, which torch sees without a copy. On a GPU a control step is a
CUDA graph.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from needlehoop.engines import warp_device
from needlehoop.engines.contract import Channels, EngineConfig
from needlehoop.engines.engine import STATE, Engine, Index
from needlehoop.engines.rasteriser.renderer import ParallelRasteriser
from needlehoop.engines.warp_device import start_warp
from needlehoop.scene.image_size import ImageSize
from needlehoop.tasks.contract import Robot, Weld

_OWN = (
    *("eq_data", "geom_friction", "body_mass", "body_inertia", "body_subtreemass"),
    *("body_invweight0", "dof_invweight0", "tendon_invweight0"),
)
"""Fields of the model that every environment has for itself."""

_ROWS = 4
"""Rows of constraints that a contact takes, at most."""

_OTHER_ROWS = 64
"""Rows beside them: equalities, limits, friction of joints."""

_FULL = ~(mjw.OverflowType.ITERATIONS | mjw.OverflowType.LS_ITERATIONS)
"""Bits of ``overflow`` that say that something was left out, not that a solver stopped early."""

_FASTEST = 1e10
"""Speeds above which the physics has broken down, as in MuJoCo, m/s or rad/s."""


class WarpEngine(Engine):
    """``n`` scenes on a device. Arguments as for ``HostEngine``.

    Raises ``ValueError`` where the device is not there, and ``RuntimeError`` in ``reset`` or
    ``snapshot`` where an environment had more contacts than there is room for.
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
        if quality > 1:
            raise ValueError(f"quality: {quality}; engine=warp draws with quality=1 alone")
        start_warp()
        self.device = config.torch_device
        self._contacts = config.contacts
        rows = _ROWS * config.contacts + _OTHER_ROWS
        with warp_device.on(self.device):
            self._m = mjw.put_model(model, batch_sizes=dict.fromkeys(_OWN, num_envs))
            self._d = mjw.make_data(model, nworld=num_envs, nconmax=config.contacts, njmax=rows)
        # Equal seeds give equal bits. What overflows is read below, and not printed by kernels.
        self._m.opt.deterministic = mjw.DeterminismType.ALL
        self._m.opt.warn_overflow = 0
        self._views: dict[str, Tensor] = {}
        self._begin = self._compiled_state()
        self._broken = torch.zeros(num_envs, dtype=torch.bool, device=self.device)
        self._graphs: dict[str, Any] = {}
        self._run("forward")
        if views:
            self._renderer = ParallelRasteriser(model, num_envs, views, size, self.device)

    def step(self, control: Tensor) -> None:
        self.read("ctrl").copy_(control)
        self._run("step")
        slow = (self.read("qvel").abs() < _FASTEST).all(1)
        bad = ~(torch.isfinite(self.read("qpos")).all(1) & slow)
        for name, value in self._begin.items():
            here = self.read(name)
            here.copy_(torch.where(_along(bad, here), value, here))
        self._broken |= bad
        self._run("forward")

    def diverged(self) -> Tensor:
        return self._broken.clone()

    def weld(self, welds: Mapping[str, Weld]) -> None:
        # Every environment is written to: which of them change is known on the device alone.
        for name, weld in welds.items():
            at = self.model.equality(name).id
            data, active = self.read("eq_data")[:, at], self.read("eq_active")[:, at]
            changed = data.clone()
            # Anchor in the second body (its origin), the same point in the first one.
            changed[:, :3] = 0.0
            changed[:, 3:10] = weld.pose.to(data)
            data.copy_(torch.where(weld.changed.unsqueeze(-1), changed, data))
            active.copy_(torch.where(weld.changed, weld.active, active))

    def read(self, name: str) -> Tensor:
        if name not in self._views:
            owner = self._d if hasattr(self._d, name) else self._m
            self._views[name] = wp.to_torch(getattr(owner, name))
        return self._views[name]

    def snapshot(self) -> dict[str, Tensor]:
        self._check_room()
        return super().snapshot()

    def write(self, name: str, ids: Tensor, value: Tensor, *at: Index) -> None:
        here = self.read(name)
        here[(ids, *at)] = value.to(here)

    def data(self, env: int) -> mujoco.MjData:
        found = mujoco.MjData(self.model)
        mjw.get_data_into(found, self.model, self._d, world_id=env)
        mujoco.mj_forward(self.model, found)
        return found

    def _compiled_state(self) -> dict[str, Tensor]:
        """What ``_clear`` writes, by field: the scene as it was compiled."""
        compiled = mujoco.MjData(self.model)
        values = {name: np.array(getattr(compiled, name)) for name in STATE}
        return {name: torch.from_numpy(one).to(self.read(name)) for name, one in values.items()}

    def _clear(self, ids: Tensor) -> None:
        self._check_room()
        self._broken[ids] = False
        for name, value in self._begin.items():
            self.read(name)[ids] = value

    def _forward(self, ids: Tensor) -> None:
        self._run("forward")

    def _set_constants(self, ids: Tensor) -> None:
        with warp_device.on(self.device):
            mjw.set_const(self._m, self._d)

    def _check_room(self) -> None:
        # Over all steps so far: a bit that was set stays set.
        full = (self.read("overflow") & _FULL) != 0
        if bool(full.any()):
            envs = full.nonzero().flatten().tolist()[:10]
            raise RuntimeError(
                f"engine.contacts: {self._contacts} are too few in environments {envs}; give more"
            )

    def _run(self, what: str) -> None:
        """``step``: physics of a control step; ``forward``: what follows from the state."""
        if self.device.type == "cpu":
            with warp_device.on(self.device):
                self._launch(what)
            return
        if what not in self._graphs:
            self._graphs[what] = self._captured(what)
        with warp_device.on(self.device):
            wp.capture_launch(self._graphs[what])

    def _captured(self, what: str) -> Any:
        """The CUDA graph of ``_launch``; the state is as before."""
        before = {name: self.read(name).clone() for name in self._state}
        torch.cuda.synchronize(self.device)
        # In a stream of Warp's, because torch's default one cannot be captured.
        with wp.ScopedDevice(wp.device_from_torch(self.device)):
            # Compiles every kernel; nothing may compile in a capture.
            self._launch(what)
            with wp.ScopedCapture() as capture:
                self._launch(what)
            wp.synchronize_device()
        for name, value in before.items():
            self.read(name).copy_(value)
        return capture.graph

    def _launch(self, what: str) -> None:
        if what == "forward":
            mjw.step1(self._m, self._d)
        for _ in range(self._substeps if what == "step" else 0):
            mjw.step(self._m, self._d)


def _along(mask: Tensor, field: Tensor) -> Tensor:
    """A mask ``(n,)`` in the shape of a field ``(n, ...)``."""
    return mask.view(-1, *[1] * (field.ndim - 1))
