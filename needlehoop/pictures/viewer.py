"""The interactive viewer: MuJoCo's own window, with somebody acting."""

from __future__ import annotations

import os
import sys
import time

import mujoco
import mujoco.viewer
import numpy as np

from needlehoop.envs.controllers import controller
from needlehoop.envs.dm_control_env import NeedleHoopTask, load
from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import View


def view(settings: Settings, who: str) -> None:
    """Open a window and run episodes in real time until it is closed.

    Raises:
        RuntimeError: this machine has no display.
        ValueError: an unknown controller.
    """
    if sys.platform.startswith("linux") and not _has_display():
        raise RuntimeError(
            "view: no display (DISPLAY and WAYLAND_DISPLAY are unset); on a machine without"
            " one, `needlehoop expert --video out.mp4` writes a video instead"
        )
    act = controller(who, settings)
    environment = load(settings)
    task = environment.task
    assert isinstance(task, NeedleHoopTask)
    model, data = environment.physics.model.ptr, environment.physics.data.ptr
    period = settings.task.timestep * settings.episode.substeps
    step = environment.reset()
    with mujoco.viewer.launch_passive(
        model, data, show_left_ui=False, show_right_ui=False
    ) as window:
        _stand_at(window.cam, settings.picture, model.vis.global_.fovy)
        while window.is_running():
            began = time.monotonic()
            if step.last():
                step = environment.reset()
            assert task.moment is not None
            with window.lock():
                step = environment.step(act(task.moment.signals)[0].numpy())
            window.sync()
            time.sleep(max(0.0, period - (time.monotonic() - began)))


def _stand_at(camera: mujoco.MjvCamera, view: View, fovy: float) -> None:
    """Put the free camera where pictures are taken from; it can be moved from there."""
    camera.lookat[:] = view.target
    # MuJoCo's azimuth is the direction of looking, 90 along y; ours is where it stands.
    camera.azimuth, camera.elevation = 90.0 - view.azimuth, -view.elevation
    zoom = np.tan(np.deg2rad(view.fovy) / 2) / np.tan(np.deg2rad(fovy) / 2)
    camera.distance = view.distance * zoom


def _has_display() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
