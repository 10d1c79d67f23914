"""Ctrl-C and a scheduler's SIGTERM, turned into an orderly stop."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Interruption:
    """A context in which the first signal only sets ``asked``; the second acts at once.

    So a run can finish its buffer and write a checkpoint.
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        self._before = {kind: signal.signal(kind, self._note) for kind in self._SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        self._put_back()

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self._put_back()
        print("\nstopping after this buffer; once more to stop at once", file=sys.stderr)

    def _put_back(self) -> None:
        for kind, handler in self._before.items():
            signal.signal(kind, handler)


@contextmanager
def terminable() -> Iterator[None]:
    """A context in which SIGTERM raises ``KeyboardInterrupt``, as Ctrl-C does."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
