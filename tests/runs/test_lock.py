"""One process at a time in a run's folder, however the last one ended."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from needlehoop.runs.machine import HeldError, held

ROOT = Path(__file__).parents[2]

HOLD = """
import sys, time
from pathlib import Path
from needlehoop.runs.machine import held
with held(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "main" / "seg_side" / "seed0"


def test_a_held_folder_is_refused_until_its_process_is_killed(folder):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    with pytest.raises(HeldError, match=f"{folder}: a run is training there"), held(folder):
        pass
    process.kill()
    process.communicate()
    with held(folder), pytest.raises(HeldError), held(folder):
        pass


def test_a_folder_is_held_by_any_of_its_names_and_where_it_is_moved(folder, tmp_path, monkeypatch):
    folder.mkdir(parents=True)
    (tmp_path / "link").symlink_to(folder)
    monkeypatch.chdir(folder.parent)
    with held(tmp_path / "link"):
        for name in (folder, Path("seed0"), Path("../seg_side/seed0")):
            with pytest.raises(HeldError), held(name):
                pass
        folder.rename(folder.with_name("seed0.1"))
        folder.mkdir()
        with pytest.raises(HeldError), held(folder):
            pass
