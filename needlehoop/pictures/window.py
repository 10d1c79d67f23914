"""MuJoCo's own window. Brings no OpenGL library but the window's."""

from __future__ import annotations

import os
import sys

import mujoco
import mujoco.viewer
import numpy as np

from needlehoop.scene.cameras import View


def has_display() -> bool:
    """Whether this machine can show a window."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or not sys.platform.startswith("linux")


def check_display(instead: str) -> None:
    """Raises ``RuntimeError`` where there is no display, with what there is ``instead``."""
    if not has_display():
        raise RuntimeError(
            "view: no display (DISPLAY and WAYLAND_DISPLAY are unset); on a machine without"
            f" one, {instead} instead"
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
