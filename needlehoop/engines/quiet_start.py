"""Starts Warp, and sets MuJoCo's warnings, without a word on the terminal or a file on the disk."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from functools import cache

import mujoco
import warp as wp

_NO_GPU = "Warp CUDA warning: Could not find or load the NVIDIA CUDA driver"
"""Warp's library prints this itself, and has no setting against it."""


@cache
def start_warp() -> None:
    """Start Warp. It must not say that there is no GPU, nor report every kernel that it loads."""
    wp.config.log_level = wp.LOG_WARNING
    try:
        stderr = os.dup(2)
    except OSError:
        # A program without standard error: there is nothing to hide.
        wp.init()
        return
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
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
    """MuJoCo's warnings are counted in its data; the engines read them there."""


def silence_mujoco() -> None:
    """Keep MuJoCo from printing warnings and writing them to ``MUJOCO_LOG.TXT``.

    A handler that the program has set already stays.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_ignore)
