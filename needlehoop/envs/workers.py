"""Threads that share work whose parts do not depend on how many threads there are."""

from __future__ import annotations

import itertools
import threading
import weakref
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, TypeVar

import torch

T = TypeVar("T")

_FEWEST, _MOST = 5, 20
"""Images of a part: below, calls cost more than work; above, they leave the processor's cache."""

_LONGEST_WAIT = 10.0
"""For a thread that is to end, s: what it is at may be stuck."""


class Workers:
    """A number of threads, at least 1, of which the caller is one.

    Each of torch's operations runs on the thread that calls it (``torch.set_num_threads(1)``):
    torch's own threads would decide how sums are rounded. So work whose rounding depends on how
    it is cut is cut by what it is, never by how many threads there are, and what comes of it has
    the same bits anywhere.
    """

    def __init__(self, threads: int):
        self.threads = threads
        self._shares: SimpleQueue[_Shared | None] = SimpleQueue()
        # Work that was begun may share out parts of its own: it must not wait in their queue.
        self._aside = ThreadPoolExecutor(1, initializer=_alone) if threads > 1 else None
        helpers = [
            threading.Thread(target=_help, args=(self._shares,), daemon=True)
            for _ in range(threads - 1)
        ]
        for helper in helpers:
            helper.start()
        weakref.finalize(self, _dismiss, self._shares, helpers)

    def map(self, work: Callable[..., T], *items: Iterable[Any]) -> list[T]:
        """``work`` on the items side by side; what it returns, in their order.

        Raises:
            Exception: what ``work`` raised, of the first item that failed, once all are done.
        """
        arguments = list(zip(*items, strict=True))
        if self.threads == 1 or len(arguments) < 2:
            return [work(*one) for one in arguments]
        shared = _Shared(work, arguments)
        for _ in range(min(self.threads, len(arguments)) - 1):
            self._shares.put(shared)
        shared.work_off()
        return shared.wait()

    def parts(self, count: int) -> list[slice]:
        """``count`` images in parts, one a thread where that suits their size.

        For work that makes the same bits of an image in any part: the parts depend on threads.
        """
        size = min(max(-(-count // self.threads), _FEWEST), _MOST)
        return [slice(at, min(at + size, count)) for at in range(0, count, size)]

    def begin(self, work: Callable[[], T]) -> Callable[[], T]:
        """Begin ``work`` beside what the caller does next; call what is returned to wait for it."""
        if self._aside is None:
            done = work()
            return lambda: done
        return self._aside.submit(work).result


class _Shared:
    """Items that threads take one by one, until none is left.

    An executor's futures wake the caller after every item, which then competes for the
    interpreter with those who work; here it works itself and is woken once.
    """

    def __init__(self, work: Callable[..., Any], arguments: list[tuple[Any, ...]]):
        self._work, self._arguments = work, arguments
        self._made: list[Any] = [None] * len(arguments)
        self._failed: dict[int, BaseException] = {}
        # A step of a count is atomic.
        self._next, self._done = itertools.count(), itertools.count(1)
        self._all_done = threading.Event()

    def work_off(self) -> None:
        """Take items until none is left to take."""
        while (at := next(self._next)) < len(self._arguments):
            try:
                self._made[at] = self._work(*self._arguments[at])
            except BaseException as error:
                self._failed[at] = error
            if next(self._done) == len(self._arguments):
                self._all_done.set()

    def wait(self) -> list[Any]:
        """What was made of the items, once all are done."""
        self._all_done.wait()
        if self._failed:
            raise self._failed[min(self._failed)]
        return self._made


def _alone() -> None:
    """Have this thread compute by itself; OpenMP counts for each thread what it may use."""
    torch.set_num_threads(1)


def _help(shares: SimpleQueue[_Shared | None]) -> None:
    _alone()
    while (shared := shares.get()) is not None:
        shared.work_off()
        # Not kept until the next one comes: it holds whole batches.
        del shared


def _dismiss(shares: SimpleQueue[_Shared | None], helpers: Sequence[threading.Thread]) -> None:
    """Let threads end, and wait for it.

    At Python's end a thread that still frees tensors would have the process aborted: torch asks
    for the interpreter then, which is none any more.
    """
    for _ in helpers:
        shares.put(None)
    for helper in helpers:
        # The last reference may have been a helper's own.
        if helper is not threading.current_thread():
            helper.join(_LONGEST_WAIT)
