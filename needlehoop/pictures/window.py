"""Episodes in MuJoCo's own window. Brings no OpenGL library but the window's."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from itertools import count
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np

from needlehoop.envs.build import PICTURE, build
from needlehoop.envs.controllers import Controller, controller, rollout
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.cameras import View


class Window:
    """MuJoCo's viewer on environment 0, from where its settings take pictures.

    Opened when first shown. Whoever makes one calls ``check_display`` before.
    """

    def __init__(self, simulation: Simulation):
        self.simulation, self._engine = simulation, simulation.engine
        # Data of its own: the engine's are on the move while the window draws.
        self._data = mujoco.MjData(self._engine.model)
        self._viewer: Any = None
        self._drawing: list[threading.Thread] = []

    @property
    def is_closed(self) -> bool:
        """Whether it was open and is no more."""
        return self._viewer is not None and not self._viewer.is_running()

    def show(self) -> None:
        """Bring the window up to this moment; one that was closed by hand stays closed."""
        if self._viewer is None:
            others = set(threading.enumerate())
            view = self.simulation.settings.picture
            self._viewer = open_window(self._engine.model, self._data, view)
            self._drawing = [one for one in threading.enumerate() if one not in others]
        if self.is_closed:
            return
        with self._viewer.lock():
            mujoco.mj_copyData(self._data, self._engine.model, self._engine.data(0))
        self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        if self._viewer is not None:
            self._viewer.close()
        # MuJoCo only asks its thread to end. A program that ended meanwhile would take OpenGL
        # away under it, and crash.
        for thread in self._drawing:
            thread.join()
        self._drawing = []


def view(settings: Settings, who: str) -> None:
    """Open a window and run episodes in real time until it is closed.

    Raises:
        RuntimeError: this machine has no display.
        ValueError: an unknown controller.
    """
    check_display("`needlehoop expert --video out.mp4` writes a video")
    alone = replace(settings, num_envs=1, cams=())
    play(Window(build(alone)), controller(who, alone), count())


def play(window: Window, act: Controller, episodes: Iterable[int]) -> None:
    """Run as many episodes as there are numbers, in real time, until the window is closed.

    The window is on a simulation of one environment; it is closed at the end.
    """
    try:
        for _ in episodes:
            due = time.monotonic()
            for _ in rollout(window.simulation, act):
                time.sleep(max(0.0, due - time.monotonic()))
                window.show()
                if window.is_closed:
                    return
                due = time.monotonic() + window.simulation.settings.period
    finally:
        window.close()


def has_display() -> bool:
    """Whether a window can be shown here."""
    return not _missing()


def check_display(instead: str) -> None:
    """Raises ``RuntimeError`` where no window can be shown, with what there is ``instead``."""
    missing = _missing()
    if missing:
        raise RuntimeError(f"no display ({missing}); without one, {instead} instead")


def _missing() -> str:
    """What a window lacks here; empty if it can be shown."""
    if sys.platform == "darwin":
        # macOS gives windows to a program's first thread, which mjpython keeps free for them.
        mjpython = getattr(mujoco.viewer, "_MJPYTHON", None)
        return "" if mjpython else "on macOS a window needs mjpython instead of python"
    if sys.platform.startswith("linux"):
        named = {name: os.environ.get(name, "") for name in ("DISPLAY", "WAYLAND_DISPLAY")}
        if not any(named.values()):
            return "DISPLAY and WAYLAND_DISPLAY are unset"
        if not _opens(*named.values()):
            told = ", ".join(f"{name}={value}" for name, value in named.items() if value)
            return f"{told} opens no window with OpenGL"
    return ""


_TRY = """
import glfw
glfw.ERROR_REPORTING = "ignore"
if not glfw.init():
    raise SystemExit(1)
glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
raise SystemExit(0 if glfw.create_window(8, 8, "", None, None) else 1)
"""


@cache
def _opens(*_: str) -> bool:
    """Whether a window opens on the displays that are named (which the environment names).

    A name may be left over from a session that is gone, as on a cluster; MuJoCo's viewer would
    end the whole program. Tried in a process of its own, as the library is one for all windows.
    """
    command = [sys.executable, "-c", _TRY]
    try:
        return subprocess.run(command, capture_output=True, timeout=30).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def open_window(model: mujoco.MjModel, data: mujoco.MjData, view: View) -> mujoco.viewer.Handle:
    """A window that looks from the view ``picture`` at first and runs beside the caller's program.

    It shows ``data`` at each ``sync``; they are changed under ``lock`` alone.
    """
    window = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    camera = window.cam
    orbit = view.orbit
    if orbit is None or view.body is not None or view.roll:
        # A free camera has its target in the room, and no roll.
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = model.camera(PICTURE).id
        return window
    camera.lookat[:] = orbit.target
    # MuJoCo's azimuth is the direction of looking, 90 along y; ours is where it stands.
    camera.azimuth, camera.elevation = 90.0 - orbit.azimuth, -orbit.elevation
    own, theirs = np.tan(np.deg2rad([view.fovy, model.vis.global_.fovy]) / 2)
    camera.distance = orbit.distance * own / theirs
    return window
