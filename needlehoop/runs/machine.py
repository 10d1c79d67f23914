"""The machine that a process runs on, as far as it may use it."""

from __future__ import annotations

import os
import platform


def machine() -> str:
    """The machine in words, for reports."""
    return f"{platform.processor() or platform.machine()}, {available_cpus()} CPUs"


def available_cpus() -> int:
    """CPUs that this process may run on: a Slurm job's share, not the machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
