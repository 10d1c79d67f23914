"""What a measurement shows while it takes minutes: a bar, where somebody watches."""

from __future__ import annotations

from collections.abc import Iterator

from tqdm import tqdm


def rounds_of(count: int, what: str) -> Iterator[int]:
    """``range(count)`` with a bar that counts ``what``; it draws between rounds, never in one."""
    # Its monitor thread would wake up in the middle of what is timed.
    tqdm.monitor_interval = 0
    bar = tqdm(range(count), desc="measuring", unit=what, leave=False, disable=None)
    yield from bar
