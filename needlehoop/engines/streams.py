"""Lets Warp and torch share a device: the same order of work, nobody waits."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch
import warp as wp


def on(device: torch.device) -> AbstractContextManager:
    """Warp's launches go to a device; on a GPU into torch's present stream."""
    if device.type == "cpu":
        return wp.ScopedDevice("cpu")
    stream = wp.stream_from_torch(torch.cuda.current_stream(device))
    return wp.ScopedStream(stream, sync_enter=False)


def warp_name(device: torch.device) -> str:
    """What Warp calls a torch device, such as ``cuda:0``."""
    return str(wp.device_from_torch(device))
