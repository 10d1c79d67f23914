"""Threads that share work whose parts have the same bits whoever does them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

T = TypeVar("T")

_FEWEST, _MOST = 5, 20
"""Images of a part: below, calls cost more than work; above, they leave the processor's cache."""


class Threads:
    """A number of threads, at least 1. One alone is the caller's own."""

    def __init__(self, count: int):
        self.count = count
        self._pool = self._aside = None
        if count > 1:
            self._pool = ThreadPoolExecutor(count, initializer=_alone)
            # Work that was begun shares out parts of its own: it must not wait in their queue.
            self._aside = ThreadPoolExecutor(1, initializer=_alone)

    def map(self, work: Callable[..., T], *items: Iterable[Any]) -> list[T]:
        """``work`` on the items side by side; what it returns, in their order."""
        return list((self._pool.map if self._pool else map)(work, *items))

    def parts(self, images: int) -> list[slice]:
        """A number of images in parts, one a thread where that suits their size."""
        size = min(max(-(-images // self.count), _FEWEST), _MOST)
        return [slice(at, min(at + size, images)) for at in range(0, images, size)]

    def begin(self, work: Callable[[], T]) -> Callable[[], T]:
        """Begin ``work`` beside what the caller does next; call what is returned to wait for it."""
        if self._aside is None:
            done = work()
            return lambda: done
        return self._aside.submit(work).result


def _alone() -> None:
    """Have this thread compute by itself; OpenMP counts for each thread what it may use."""
    torch.set_num_threads(1)
