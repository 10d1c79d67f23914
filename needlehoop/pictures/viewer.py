"""The interactive viewer: MuJoCo's own window, with somebody acting."""

from __future__ import annotations

import time

from needlehoop.envs.controllers import controller
from needlehoop.envs.dm_control_env import NeedleHoopTask, load
from needlehoop.envs.settings import Settings
from needlehoop.pictures.window import check_display, open_window


def view(settings: Settings, who: str) -> None:
    """Open a window and run episodes in real time until it is closed.

    Raises:
        RuntimeError: this machine has no display.
        ValueError: an unknown controller.
    """
    check_display("`needlehoop expert --video out.mp4` writes a video")
    act = controller(who, settings)
    environment = load(settings)
    task = environment.task
    assert isinstance(task, NeedleHoopTask)
    model, data = environment.physics.model.ptr, environment.physics.data.ptr
    period = settings.task.timestep * settings.episode.substeps
    step = environment.reset()
    with open_window(model, data, settings.picture) as window:
        while window.is_running():
            began = time.monotonic()
            if step.last():
                step = environment.reset()
            assert task.moment is not None
            with window.lock():
                step = environment.step(act(task.moment.signals)[0].numpy())
            window.sync()
            time.sleep(max(0.0, period - (time.monotonic() - began)))
