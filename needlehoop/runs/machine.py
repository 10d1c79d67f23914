"""A process and its machine: what files note of them, signals, one process to a folder."""

from __future__ import annotations

import os
import platform
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

_PACKAGES = ("needlehoop", "torch", "torchrl", "tensordict", "mujoco", "mujoco-warp", "warp-lang")
_PACKAGES += ("dm_control", "hydra-core")


def available_cpus() -> int:
    """CPUs that this process may run on: a Slurm job's share, not the machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def peak_memory() -> float:
    """The most memory this process has had, GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)


def import_extra(module: str, by: str, extra: str) -> Any:
    """A module of an extra; ``ValueError`` that says how to install it."""
    try:
        return import_module(module)
    except ImportError as error:
        missing = error.name or module
        raise ValueError(f"{by} needs {missing}: pip install 'needlehoop[{extra}]'") from error


def provenance() -> dict[str, Any]:
    """Commit, versions, machine and time, as plain values for a manifest."""
    # Imported where it is used: those who ask for CPUs need not wait for it.
    import torch

    return {
        "commit": commit(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in _PACKAGES},
        "platform": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "cpus": os.cpu_count(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def commit() -> str | None:
    """The git commit, with ``+`` where the source differs from it; ``None`` outside git."""
    source = (".", "../train.py", "../conf")
    here = Path(__file__).parents[1]

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        commit = git("rev-parse", "--short=12", "HEAD")
        return commit + ("+" if git("status", "--porcelain", "--", *source) else "")
    except (OSError, subprocess.CalledProcessError):
        return None


@contextmanager
def interruption() -> Iterator[threading.Event]:
    """A context in which the first Ctrl-C or SIGTERM only sets the event; the second acts at once.

    So a run can finish its buffer and write a checkpoint.
    """
    stop_request = threading.Event()

    def note(number: int, frame: Any) -> None:
        stop_request.set()
        before.close()
        print("\nstopping after this buffer; once more to stop at once", file=sys.stderr)

    with ExitStack() as before:
        for kind in (signal.SIGINT, signal.SIGTERM):
            before.callback(signal.signal, kind, signal.signal(kind, note))
        yield stop_request


@contextmanager
def terminable() -> Iterator[None]:
    """A context in which SIGTERM raises ``KeyboardInterrupt``, as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class HeldError(ValueError):
    """Another process is at work in the folder."""


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """A context in which no other process holds a folder.

    The lock is the file ``.<name>.lock`` beside the folder, because a run's folder is moved and
    replaced. The kernel releases it when the process ends, however it ends. Raises ``HeldError`` if
    another process holds it.
    """
    place = folder.resolve()
    path = place.with_name(f".{place.name}.lock")
    place.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise HeldError(
            f"{folder}: a run is training there; wait for it, or stop it first"
        ) from error
    try:
        yield
    finally:
        # Still locked: a process that opened the file before sees that it is gone.
        path.unlink(missing_ok=True)
        lock.release()
