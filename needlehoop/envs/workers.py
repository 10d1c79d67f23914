"""Threads that share work whose parts do not depend on how many threads there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")


class Workers:
    """A number of threads.

    Each of torch's operations runs on the thread that calls it (``torch.set_num_threads(1)``):
    torch's own threads would decide how sums are rounded. So work is cut into parts by what
    it is, never by how many threads there are, and what comes of it has the same bits anywhere.

    Args:
        threads: at least 1; with 1 the caller works itself.
    """

    def __init__(self, threads: int):
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        # Work that was begun may share out parts of its own: it must not wait in their queue.
        self._aside = ThreadPoolExecutor(1) if threads > 1 else None

    def map(self, work: Callable[..., T], *items: Iterable[Any]) -> list[T]:
        """``work`` on the items side by side; what it returns, in their order."""
        if self._pool is None:
            return [work(*parts) for parts in zip(*items, strict=True)]
        return list(self._pool.map(work, *items))

    def begin(self, work: Callable[[], T]) -> Callable[[], T]:
        """Begin ``work`` beside what the caller does next; call what is returned to wait for it."""
        if self._aside is None:
            done = work()
            return lambda: done
        return self._aside.submit(work).result
