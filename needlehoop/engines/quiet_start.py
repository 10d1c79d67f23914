"""Keeps Warp and MuJoCo from printing what a user need not know."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from functools import cache

import mujoco
import warp as wp

_NO_GPU = "Warp CUDA warning: Could not find or load the NVIDIA CUDA driver"
"""Warp's C++ library prints this, and has no setting against it."""


@cache
def start_warp() -> None:
    """Start Warp without its messages about missing GPUs and loaded kernels."""
    wp.config.log_level = wp.LOG_WARNING
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            caught.seek(0)
            said = caught.read().decode(errors="replace").splitlines(keepends=True)
            sys.stderr.write("".join(line for line in said if not line.startswith(_NO_GPU)))


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _ignore(message: bytes) -> None:
    pass


def silence_mujoco() -> None:
    """Keep MuJoCo from writing warnings to ``MUJOCO_LOG.TXT``: the engines read them in its data.

    A handler that the program has set already stays.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_ignore)
