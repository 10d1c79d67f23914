"""Runs of a sweep side by side: joblib's queue, and for each run a process of its own.

joblib's own pool has two faults here. Killing one of its workers ends all of them, and its workers
outlive a parent that is killed.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
from collections.abc import Callable
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Any

import cloudpickle
from hydra.core.utils import JobReturn, JobStatus
from joblib import register_parallel_backend
from joblib.parallel import ThreadingBackend

from needlehoop.runs.machine import terminable
from needlehoop.runs.reading import printable

_SPAWN = get_context("spawn")
_STOPPED = 130
"""Exit status of a process whose run was stopped by a signal."""


def use_own_processes() -> None:
    """Have joblib start our processes where Hydra's launcher asks for its pool, ``loky``."""
    register_parallel_backend("loky", OwnProcesses)


class OwnProcesses(ThreadingBackend):
    """Threads of joblib's, each of which starts a process for a run and waits for it."""

    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs)
        self._running: set[Any] = set()
        self._lock = threading.Lock()
        self._is_stopping = False

    def submit(self, func: Callable[[], Any], callback: Any = None) -> Any:
        """Called by joblib: begin a run as soon as a thread is free."""
        return super().submit(partial(self._run, func), callback)

    def terminate(self) -> None:
        """Called by joblib at the end, whatever it is: stop in order what is still running.

        A second signal while runs finish their buffers stops them at once.
        """
        try:
            self._stop()
        except KeyboardInterrupt:
            self._stop()
        super().terminate()

    def _stop(self) -> None:
        """Ask all that runs to stop, and wait until it has."""
        with self._lock:
            self._is_stopping = True
            running = [*self._running]
        for process in running:
            process.terminate()
        for process in running:
            # Not join: the thread that started it does that.
            wait([process.sentinel])

    def _run(self, call: Callable[[], Any]) -> list[JobReturn]:
        # The process inherits the mask: at a terminal Ctrl-C is not for it, but for its parent.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        receiver, sender = _SPAWN.Pipe(duplex=False)
        process = _SPAWN.Process(target=_work, args=(cloudpickle.dumps(call), sender))
        with self._lock:
            if self._is_stopping:
                return []
            process.start()
            # Its own end alone is left: what is read ends with the process.
            sender.close()
            self._running.add(process)
        process.join()
        with self._lock:
            self._running.discard(process)
        if process.exitcode == _STOPPED:
            raise KeyboardInterrupt
        if process.exitcode and process.exitcode > 0:
            raise ChildProcessError("a run of the sweep could not begin; its error is above")
        try:
            objective = receiver.recv()
        except EOFError:
            # A killed process left its note as it was: the summary names the run.
            objective = math.nan
        return [JobReturn(status=JobStatus.COMPLETED, _return_value=objective)]


def _work(call: bytes, sender: Connection) -> None:
    """The process of one run; sends what the run returns."""
    with terminable():
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
            threading.Thread(target=_stop_with_parent, daemon=True).start()
            (done,) = cloudpickle.loads(call)()
            # Raises what Hydra caught.
            sender.send(done.return_value)
        except KeyboardInterrupt:
            sys.exit(_STOPPED)
        except Exception as error:
            sys.exit(printable(f"{type(error).__name__}: {' '.join(str(error).split())}"))


def _stop_with_parent() -> None:
    """Stop in order where the parent is gone: nobody else would stop this process."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
