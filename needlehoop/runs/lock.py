"""One process at a time in a folder."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import platform
import sys
from pathlib import Path

from needlehoop.runs.files import naming

_MISSING = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""What flock says where a file system has no locks."""

_LONGEST_NOTE = 1_000


class HeldError(ValueError):
    """Another process is at work in the folder; says which."""


class Lock:
    """Holds a folder for this process, from its making until ``release``.

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

    def __init__(self, folder: Path):
        place = folder.resolve()
        self._folder = folder
        self._path = place.with_name(f".{place.name}.lock")
        self._made = [above for above in place.parents if not above.exists()]
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file = self._take()
        except BaseException:
            self._tidy()
            raise

    def release(self) -> None:
        """Release the lock; remove its file, and empty folders that were made above it."""
        if self._file >= 0:
            # While it is held: whoever opened it before sees that it is gone.
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1
            self._tidy()

    def __enter__(self) -> Lock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _take(self) -> int:
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
            try:
                self._lock(file)
                if _is(file, self._path):
                    with naming(self._path):
                        os.ftruncate(file, 0)
                        os.pwrite(file, _note().encode(), 0)
                    return file
            except BaseException:
                os.close(file)
                raise
            # Its last holder took it away between our opening and locking it.
            os.close(file)

    def _lock(self, file: int) -> None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _holder(file)
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise HeldError(self._refusal(*holder)) from error
            if error.errno not in _MISSING:
                with naming(self._path):
                    raise
            if holder[0] == platform.node() and _is_alive(holder[1]):
                raise HeldError(self._refusal(*holder)) from error
            print(
                f"{self._path.parent}: its file system has no locks; do not work on"
                f" {self._folder} from two machines",
                file=sys.stderr,
            )

    def _refusal(self, host: str, process: int) -> str:
        who = f"process {process} on {host}" if process else "another process"
        return f"{self._folder} is in the hands of {who}; wait for it, or stop it first"

    def _tidy(self) -> None:
        for folder in self._made:
            try:
                folder.rmdir()
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOENT):
                    raise
                return


def _note() -> str:
    return json.dumps({"host": platform.node(), "process": os.getpid()}) + "\n"


def _holder(file: int) -> tuple[str, int]:
    """Host and process that a lock's file notes; ``("", 0)`` where it notes none yet."""
    try:
        note = json.loads(os.pread(file, _LONGEST_NOTE, 0))
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
    if process < 1 or process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
