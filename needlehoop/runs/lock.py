"""One process at a time in a folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout


class HeldError(ValueError):
    """Another process is at work in the folder."""


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """A context in which no other process holds a folder.

    The lock is the file ``.<name>.lock`` beside the folder, because a run's folder is moved and
    replaced. The kernel releases it when the process ends, however it ends. Folders above that
    are made here and stay empty are removed.

    Raises:
        HeldError: another process holds it.
    """
    place = folder.resolve()
    path = place.with_name(f".{place.name}.lock")
    made = [above for above in place.parents if not above.exists()]
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
        # While it is locked. A process that has opened the file before sees that it is gone.
        path.unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):
            for above in made:
                above.rmdir()
