"""Starts Warp without words, and lets it share a device with torch."""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import AbstractContextManager
from functools import cache

import torch
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
            lines = caught.read().decode(errors="replace").splitlines(keepends=True)
            sys.stderr.write("".join(line for line in lines if not line.startswith(_NO_GPU)))


def on(device: torch.device) -> AbstractContextManager:
    """Warp's launches go to a device; on a GPU into torch's present stream, and nobody waits."""
    if device.type == "cpu":
        return wp.ScopedDevice("cpu")
    stream = wp.stream_from_torch(torch.cuda.current_stream(device))
    return wp.ScopedStream(stream, sync_enter=False)
