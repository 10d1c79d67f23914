"""One process at a time in a run's folder, however the last one ended."""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from needlehoop.runs.lock import HeldError, held

ROOT = Path(__file__).parents[2]

HOLD = """
import sys, time
from pathlib import Path
from needlehoop.runs.lock import held
with held(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "main" / "seg_side" / "seed0"


def hold(folder: Path) -> subprocess.Popen[str]:
    """Another process that holds a folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_held_folder_is_refused_with_its_holder_who_may_be_killed(folder):
    process = hold(folder)
    said = f"{folder} is in the hands of process {process.pid} on {platform.node()}"
    with pytest.raises(HeldError, match=said), held(folder):
        pass
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with held(folder), pytest.raises(HeldError, match=f"process {os.getpid()}"), held(folder):
        pass


def test_nothing_is_left_of_a_lock(folder, tmp_path):
    with held(folder):
        assert [path.name for path in folder.parent.iterdir()] == [".seed0.lock"]
    assert list(tmp_path.iterdir()) == []
    folder.mkdir(parents=True)
    with held(folder):
        pass
    assert [path.name for path in folder.parent.iterdir()] == ["seed0"]


def test_a_folder_is_held_by_any_of_its_names(folder, tmp_path, monkeypatch):
    folder.mkdir(parents=True)
    (tmp_path / "link").symlink_to(folder)
    monkeypatch.chdir(folder.parent)
    with held(tmp_path / "link"):
        for name in (folder, Path("seed0"), Path("../seg_side/seed0")):
            with pytest.raises(HeldError), held(name):
                pass


def test_a_folder_may_be_moved_and_made_while_it_is_held(folder):
    folder.mkdir(parents=True)
    with held(folder):
        folder.rename(folder.with_name("seed0.1"))
        folder.mkdir()
        with pytest.raises(HeldError), held(folder):
            pass


def test_a_lock_taken_away_while_it_was_waited_for_is_taken_anew(folder, monkeypatch):
    """Whoever locks a file that its holder has just removed holds nothing."""
    first = ExitStack()
    first.enter_context(held(folder))
    path = folder.with_name(".seed0.lock")
    real = fcntl.flock
    released = []

    def late(file: int, kind: int) -> None:
        if not released:
            released.append(True)
            first.close()
            path.parent.mkdir(parents=True)
        real(file, kind)

    monkeypatch.setattr(fcntl, "flock", late)
    with held(folder):
        monkeypatch.undo()
        with pytest.raises(HeldError), held(folder):
            pass


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_without_locks_the_note_keeps_one_machine_apart(folder, monkeypatch, capsys, code):
    process = hold(folder)

    def missing(file: int, kind: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", missing)
    with pytest.raises(HeldError, match=f"process {process.pid}"), held(folder):
        pass
    assert capsys.readouterr().err == ""
    process.kill()
    process.communicate()
    with held(folder):
        assert "its file system has no locks" in capsys.readouterr().err


def test_a_folder_that_nobody_may_write_names_the_lock(folder, monkeypatch):
    def refused(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(fcntl, "flock", refused)
    with pytest.raises(OSError, match=r"Read-only file system: .*\.seed0\.lock"), held(folder):
        pass


def test_a_lock_is_no_way_to_write_elsewhere(folder, tmp_path):
    folder.parent.mkdir(parents=True)
    (tmp_path / "thesis").write_text("years of work")
    folder.with_name(".seed0.lock").symlink_to(tmp_path / "thesis")
    with pytest.raises(OSError, match=r"\.seed0\.lock"), held(folder):
        pass
    assert (tmp_path / "thesis").read_text() == "years of work"
