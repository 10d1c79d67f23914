"""What an engine is: physics and cameras of ``n`` copies of one scene.

An engine holds no task logic. ``Simulation`` drives it: commands in, sensor data out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import mujoco
import numpy as np
from torch import Tensor

from needlehoop.engines.addresses import Addresses
from needlehoop.engines.contract import Channels, EngineConfig, Frame, Optics, Renderer
from needlehoop.engines.quiet_start import silence_mujoco
from needlehoop.engines.rasteriser.renderer import Rasteriser
from needlehoop.runs.machine import available_cpus
from needlehoop.tasks.contract import Robot, Weld
from needlehoop.tasks.start import Start


class Engine(ABC):
    """Physics and cameras of ``num_envs`` scenes.

    Args:
        model: the compiled scene.
        robot: in it.
        num_envs: copies of it.
        substeps: physics steps per control step.
        views: channels to render by view; empty for no cameras.
        size: image width and height, px.
        quality: of the images, see ``Tracer``.
        config: threads and renderer.

    Raises:
        ValueError: a size or scene that can't be rendered.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: Robot,
        num_envs: int,
        substeps: int,
        views: Mapping[str, Channels],
        size: int,
        quality: int,
        config: EngineConfig,
    ):
        silence_mujoco()
        self.num_envs, self.model = num_envs, model
        self._substeps, self._threads = substeps, config.threads or available_cpus()
        self._addresses = Addresses(model, robot)
        given = (model, num_envs, views, size, self._threads)
        self._renderer = make_renderer(config.renderer, quality, *given) if views else None

    @abstractmethod
    def reset(self, ids: Tensor, start: Start) -> None:
        """Put environments ``ids`` ``(k,)`` at their starts (batch size k), and forward."""

    @abstractmethod
    def step(self, control: Tensor) -> None:
        """Advance all by one control step under ``control`` ``(n, nu)``, then forward."""

    @abstractmethod
    def diverged(self) -> Tensor:
        """Environments ``(n,)`` bool whose physics broke down since their reset.

        MuJoCo puts such a scene back to where it was compiled, and goes on.
        """

    @abstractmethod
    def weld(self, welds: Mapping[str, Weld]) -> None:
        """Switch welds, by name; they act from the next step on."""

    @abstractmethod
    def sensordata(self) -> Tensor:
        """Sensor data ``(n, nsensordata)`` float64 at the present state; a copy."""

    @abstractmethod
    def snapshot(self) -> dict[str, Tensor]:
        """The physics' whole state, as copies."""

    @abstractmethod
    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Go on from a ``snapshot``, and forward."""

    @abstractmethod
    def vary(self, ids: Tensor, friction: Tensor, mass: Tensor) -> None:
        """Scale friction of all geoms and mass of free bodies, by factors ``(k,)``.

        Of the model as it was compiled; to be called before these environments' ``reset``.
        """

    def render(self, ids: Tensor | None = None, optics: Optics | None = None) -> dict[str, Frame]:
        """Frames of environments ``ids`` ``(k,)`` (all by default) by view.

        Views are chosen at construction. ``optics`` changes what is drawn, and no physics.
        """
        if self._renderer is None:
            return {}
        fields = self._drawn() if optics is None else optics(self._drawn())
        return self._renderer.render(fields, None if ids is None else ids.numpy())

    @abstractmethod
    def _drawn(self) -> Mapping[str, np.ndarray]:
        """``FIELDS`` of all environments, where there are cameras."""

    @abstractmethod
    def data(self, env: int) -> mujoco.MjData:
        """One environment's MjData, forwarded, to look at; valid until the next call."""


def make_renderer(
    kind: str,
    quality: int,
    model: mujoco.MjModel,
    num_envs: int,
    views: Mapping[str, Channels],
    size: int,
    threads: int,
) -> Renderer:
    """A renderer of a kind of ``RENDERERS``; pictures for people (``quality`` > 1) are traced."""
    if kind == "rasteriser" and quality == 1:
        return Rasteriser(model, num_envs, views, size, threads)
    # Imported where it is used: mujoco_warp takes two seconds.
    from needlehoop.engines.tracer import Tracer

    return Tracer(model, num_envs, views, size, quality)
