"""Threads that share work whose parts do not depend on how many threads there are."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

_FEWEST, _MOST = 5, 20
"""Images of a part: below, calls cost more than work; above, they leave the processor's cache."""


class Workers:
    """A number of threads.

    Each of torch's operations runs on the thread that calls it (``torch.set_num_threads(1)``):
    torch's own threads would decide how sums are rounded. So work whose rounding depends on how
    it is cut is cut by what it is, never by how many threads there are, and what comes of it has
    the same bits anywhere.

    Args:
        threads: at least 1, of which the caller is one.
    """

    def __init__(self, threads: int):
        self.threads = threads
        # One more than ``map`` uses, for what was begun.
        self._pool = ThreadPoolExecutor(threads)

    def map(self, work: Callable[..., T], *items: Iterable[Any]) -> list[T]:
        """``work`` on the items side by side; what it returns, in their order.

        Raises:
            Exception: what ``work`` raised, of the first item that failed, once all are done.
        """
        arguments = list(zip(*items, strict=True))
        if self.threads == 1 or len(arguments) < 2:
            return [work(*one) for one in arguments]
        # Threads take the items one by one. The pool's futures would wake the caller after every
        # item; here it works itself and is woken once.
        made: list[Any] = [None] * len(arguments)
        failed: dict[int, BaseException] = {}
        # A step of a count is atomic.
        taken, done = itertools.count(), itertools.count(1)
        all_done = threading.Event()

        def work_off() -> None:
            while (at := next(taken)) < len(arguments):
                try:
                    made[at] = work(*arguments[at])
                except BaseException as error:
                    failed[at] = error
                if next(done) == len(arguments):
                    all_done.set()

        for _ in range(min(self.threads, len(arguments)) - 1):
            self._pool.submit(work_off)
        work_off()
        all_done.wait()
        if failed:
            raise failed[min(failed)]
        return made

    def parts(self, count: int) -> list[slice]:
        """``count`` images in parts, one a thread where that suits their size.

        For work that makes the same bits of an image in any part: the parts depend on threads.
        """
        size = min(max(-(-count // self.threads), _FEWEST), _MOST)
        return [slice(at, min(at + size, count)) for at in range(0, count, size)]

    def begin(self, work: Callable[[], T]) -> Callable[[], T]:
        """Begin ``work`` beside what the caller does next; call what is returned to wait for it."""
        if self.threads == 1:
            done = work()
            return lambda: done
        return self._pool.submit(work).result
