"""What is drawn says nothing about Warp, with a GPU or without."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SCRIPT = """
import os, sys
from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
simulation = build(compose_settings(
    ["cams=rgb_front", "num_envs=1", "image_size=16", "engine.threads=1", "engine.renderer=NAME"]))
simulation.reset()
assert simulation.images()
if "NAME" == "rasteriser":
    assert "mujoco_warp" not in sys.modules
os.write(2, b"still heard")
"""


@pytest.mark.parametrize("renderer", ["rasteriser", pytest.param("tracer", marks=pytest.mark.full)])
def test_a_renderer_starts_without_a_word(renderer):
    command = [sys.executable, "-c", SCRIPT.replace("NAME", renderer)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=True)
    assert done.stdout == ""
    assert done.stderr == "still heard"
