"""The scripts in ``launch/``: which command each of them is."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

LAUNCH = Path(__file__).parents[2] / "launch"


@pytest.fixture
def scripts(tmp_path: Path) -> Path:
    """The scripts beside a Python that only says what it was given."""
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    (programs / "python").write_text('#!/bin/sh\necho "$@"\n')
    (programs / "python").chmod(0o755)
    return Path(shutil.copytree(LAUNCH, tmp_path / "launch"))


def say(script: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([script, *words], cwd=os.sep, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("words", "command"),
    [
        ("table2.sh seed=0,1", "+experiment=table2 seed=0,1"),
        ("slurm.sh table2 seed=1", "+experiment=table2 hydra/launcher=slurm seed=1"),
        (
            "ray.sh table2 seed=1",
            "+experiment=table2 hydra/launcher=ray +hydra.launcher.ray.remote.num_cpus=2 seed=1",
        ),
    ],
)
def test_a_script_is_one_command_from_any_folder(scripts, words, command):
    name, *overrides = words.split()
    done = say(scripts / name, *overrides)
    assert (done.returncode, done.stdout) == (0, f"train.py {command}\n")


@pytest.mark.parametrize("name", ["slurm.sh", "ray.sh"])
def test_a_script_that_needs_a_word_shows_its_use(scripts, name):
    done = say(scripts / name)
    assert done.returncode == 2
    assert f"launch/{name} " in done.stderr
