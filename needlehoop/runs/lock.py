"""One process at a time in a folder."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from needlehoop.runs.files import naming

_MISSING = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""What flock says where a file system has no locks."""


class HeldError(ValueError):
    """Another process is at work in the folder; says which."""


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """A context in which no other process holds a folder; empty folders above it vanish after it.

    The lock is flock(2) on ``.<name>.lock`` beside the folder, so the folder may be made, moved
    and replaced meanwhile. The kernel releases it when the process ends, however it ends.

    On local disks, on NFS (Linux sends flock to the server) and on cluster file systems with
    locks, such as Lustre mounted with ``flock``: one process on all machines. On mounts with
    local locks (``nolock``, ``localflock``): one process on each machine. Without any locks, the
    file's note of its holder separates processes of one machine, unless they begin at the same
    moment; a line on standard error says so.

    Args:
        folder: whether there already or not; the folders above it are made.

    Raises:
        HeldError: another process holds it.
    """
    place = folder.resolve()
    path = place.with_name(f".{place.name}.lock")
    made = [above for above in place.parents if not above.exists()]
    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        file = _taken(path, folder)
        try:
            yield
        finally:
            try:
                # While it is held: whoever opened it before sees that it is gone.
                path.unlink(missing_ok=True)
            finally:
                os.close(file)
    finally:
        # Those with something in them stay.
        with suppress(OSError):
            for above in made:
                above.rmdir()


def _taken(path: Path, folder: Path) -> int:
    """The descriptor of a lock's file, which is locked and notes its holder."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            with naming(path):
                _lock(file, folder)
                if _is(file, path):
                    os.ftruncate(file, 0)
                    note = {"host": platform.node(), "process": os.getpid()}
                    os.pwrite(file, json.dumps(note).encode() + b"\n", 0)
                    return file
        except BaseException:
            os.close(file)
            raise
        # Its last holder took it away between our opening and locking it.
        os.close(file)


def _lock(file: int, folder: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        host, process = _holder(file)
        is_here = host == platform.node() and _is_alive(process)
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES) or (
            error.errno in _MISSING and is_here
        ):
            who = f"process {process} on {host}" if process else "another process"
            raise HeldError(
                f"{folder} is in the hands of {who}; wait for it, or stop it first"
            ) from error
        if error.errno not in _MISSING:
            raise
        print(
            f"{folder.parent}: its file system has no locks; do not work on {folder} from two"
            " machines",
            file=sys.stderr,
        )


def _holder(file: int) -> tuple[str, int]:
    """Host and process that a lock's file notes; ``("", 0)`` where it notes none yet."""
    try:
        note = json.loads(os.pread(file, 1_000, 0))
        return str(note["host"]), int(note["process"])
    except (ValueError, TypeError, KeyError):
        return "", 0


def _is(file: int, path: Path) -> bool:
    """Whether an open file is the one at a path."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError as error:
        return error.errno == errno.EPERM
    return process != os.getpid()
