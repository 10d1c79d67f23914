"""MuJoCo's window on a screen that nobody looks at."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

SHOWN = """
import gymnasium, numpy as np, pathlib, time
env = gymnasium.make("needlehoop:needlehoop/NeedleHoop-v0", cams=["seg_side"], render_mode="human")
env.reset(seed=0)
screen = pathlib.Path(r"{screen}")
for _ in range(200):
    env.step(np.zeros(5, np.float32))
    # A blank screen has one colour; before the pixels stands the file's head.
    if len(set(screen.read_bytes()[-640 * 480 * 4 :])) > 100:
        print("drawn")
        break
    time.sleep(0.1)
env.close()
"""


@pytest.fixture
def screen(tmp_path):
    """A virtual screen: its display, and the file with its pixels."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb here: apt-get install xvfb libgl1-mesa-dri")
    read, write = os.pipe()
    words = ["-displayfd", str(write), "-screen", "0", "640x480x24", "-fbdir", str(tmp_path)]
    server = subprocess.Popen(
        ["Xvfb", *words], pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(write)
    with os.fdopen(read) as told:
        display = told.readline().strip()
    assert display, "Xvfb did not start"
    yield f":{display}", tmp_path / "Xvfb_screen0"
    server.terminate()
    server.wait()


def test_a_program_draws_in_a_window_and_ends_well(screen):
    display, pixels = screen
    environ = {k: v for k, v in os.environ.items() if k != "WAYLAND_DISPLAY"}
    ended = subprocess.run(
        [sys.executable, "-c", SHOWN.format(screen=pixels)],
        env={**environ, "DISPLAY": display},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    # MuJoCo's thread may still draw when the program ends, which used to be a crash.
    assert ended.returncode == 0, ended.stderr
    assert "drawn" in ended.stdout, ended.stderr
