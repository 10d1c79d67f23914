"""What is drawn says nothing about Warp, with a GPU or without."""

from __future__ import annotations

import os
import subprocess
import sys

SCRIPT = """
import os, sys
from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
simulation = build(compose_settings(
    ["cams=rgb_front", "num_envs=1", "image_size=16", "engine.threads=1"]))
simulation.reset()
assert simulation.images()
assert "mujoco_warp" not in sys.modules
os.write(2, b"still heard")
"""


def test_a_renderer_starts_without_a_word():
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=True)
    assert done.stdout == ""
    assert done.stderr == "still heard"
