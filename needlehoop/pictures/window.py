"""MuJoCo's own window, and what it shows. Brings no OpenGL library but the window's."""

from __future__ import annotations

import os
import sys
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np

from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.cameras import View


class Window:
    """MuJoCo's viewer on environment 0; opened when first shown.

    Args:
        simulation: what is shown.
        settings: of the simulation, for the place to look from.
        instead: what a machine without a display can do.

    Raises:
        RuntimeError: this machine has no display.
    """

    def __init__(self, simulation: Simulation, settings: Settings, instead: str):
        check_display(instead)
        self._engine, self._view = simulation.engine, settings.picture
        # Data of its own: the engine's are on the move while the window draws.
        self._data = mujoco.MjData(self._engine.model)
        self._viewer: Any = None

    @property
    def is_closed(self) -> bool:
        """Whether it was open and is no more."""
        return self._viewer is not None and not self._viewer.is_running()

    def show(self) -> None:
        """Bring the window up to this moment; one that was closed by hand stays closed."""
        if self._viewer is None:
            self._viewer = open_window(self._engine.model, self._data, self._view)
        if self.is_closed:
            return
        with self._viewer.lock():
            mujoco.mj_copyData(self._data, self._engine.model, self._engine.data(0))
        self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        if self._viewer is not None:
            self._viewer.close()


def has_display() -> bool:
    """Whether this machine can show a window."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or not sys.platform.startswith("linux")


def check_display(instead: str) -> None:
    """Raises ``RuntimeError`` where there is no display, with what there is ``instead``."""
    if not has_display():
        raise RuntimeError(
            "no display (DISPLAY and WAYLAND_DISPLAY are unset); on a machine without one,"
            f" {instead} instead"
        )


def open_window(model: mujoco.MjModel, data: mujoco.MjData, view: View) -> mujoco.viewer.Handle:
    """A window on ``data`` that stands at a view and runs beside the caller's program.

    Args:
        model: the scene.
        data: shown at each ``sync``; changed under ``lock`` alone.
        view: where to look from at first.
    """
    window = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    _stand_at(window.cam, view, model.vis.global_.fovy)
    return window


def _stand_at(camera: mujoco.MjvCamera, view: View, fovy: float) -> None:
    """Put the free camera where pictures are taken from; it can be moved from there."""
    camera.lookat[:] = view.target
    # MuJoCo's azimuth is the direction of looking, 90 along y; ours is where it stands.
    camera.azimuth, camera.elevation = 90.0 - view.azimuth, -view.elevation
    zoom = np.tan(np.deg2rad(view.fovy) / 2) / np.tan(np.deg2rad(fovy) / 2)
    camera.distance = view.distance * zoom
