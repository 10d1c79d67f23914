"""Threads that share work; each part gives the same bits on any thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

T = TypeVar("T")

_FEWEST, _MOST = 5, 20
"""Images of a part. Fewer cost more in calls than in work; more do not fit the CPU's cache."""


class Threads:
    """``count`` threads; if it is 1, that is the caller's own."""

    def __init__(self, count: int):
        self.count = count
        self._pool = self._aside = None
        if count > 1:
            self._pool = ThreadPoolExecutor(count, initializer=_alone)
            # Work that was begun calls ``map`` itself, so it must not wait in the same queue.
            self._aside = ThreadPoolExecutor(1, initializer=_alone)

    def map(self, work: Callable[..., T], *items: Iterable[Any]) -> list[T]:
        """What ``work`` returns for the items, in their order."""
        return list((self._pool.map if self._pool else map)(work, *items))

    def parts(self, images: int) -> list[slice]:
        """Slices of a number of images, one for each thread where that suits their size."""
        size = min(max(-(-images // self.count), _FEWEST), _MOST)
        return [slice(at, min(at + size, images)) for at in range(0, images, size)]

    def begin(self, work: Callable[[], T]) -> Callable[[], T]:
        """Begin ``work`` in the background; the function that is returned waits for its result."""
        if self._aside is None:
            done = work()
            return lambda: done
        return self._aside.submit(work).result


def _alone() -> None:
    """Let this thread compute alone: OpenMP's number of threads holds for each thread by itself."""
    torch.set_num_threads(1)
