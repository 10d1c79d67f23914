"""What ``render`` shows: a picture of the scene, or a window that follows it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.pictures.portrait import Photographer
from needlehoop.pictures.window import check_display, open_window

MODES = ("human", "rgb_array")


def check_mode(mode: str | None, modes: Iterable[str], size: int) -> None:
    """Raises ``ValueError`` for a mode that is not among ``modes``, or a size below 1 px."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode: {mode!r} is unknown; choose from {', '.join(modes)}")
    if size < 1:
        raise ValueError(f"render_size: {size} must be at least 1")


def rate(settings: Settings) -> float:
    """Control steps per second of simulated time."""
    return 1.0 / (settings.task.timestep * settings.episode.substeps)


class Picture:
    """Pictures of the scene from the place where those for people are taken.

    Args:
        simulation: what is pictured.
        size: height and width, px.
    """

    def __init__(self, simulation: Simulation, size: int):
        self._engine = simulation.engine
        self._photographer = Photographer(self._engine.model, size)

    def __call__(self, env: int) -> np.ndarray:
        """One environment at this moment: ``(size, size, 3)`` uint8."""
        return self._photographer(self._engine.data(env))


class Window:
    """MuJoCo's viewer on environment 0; opened when first shown.

    Args:
        simulation: what is shown.
        settings: of the simulation, for the place to look from and the time of a step.

    Raises:
        RuntimeError: this machine has no display.
    """

    def __init__(self, simulation: Simulation, settings: Settings):
        check_display("render_mode=rgb_array gives pictures")
        self._engine, self._settings = simulation.engine, settings
        self._data = mujoco.MjData(self._engine.model)
        self._viewer: Any = None

    def show(self) -> None:
        """Bring the window up to this moment; one that was closed by hand stays closed."""
        if self._viewer is None:
            self._viewer = open_window(self._engine.model, self._data, self._settings.picture)
        if not self._viewer.is_running():
            return
        with self._viewer.lock():
            mujoco.mj_copyData(self._data, self._engine.model, self._engine.data(0))
        self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        if self._viewer is not None:
            self._viewer.close()
