"""The scripts in ``launch/``: which command each of them is."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

LAUNCH = Path(__file__).parents[2] / "launch"


@pytest.fixture
def scripts(tmp_path: Path) -> Path:
    """The scripts beside programs that only say what they were given."""
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name, says in (("python", 'echo "$@"'), ("needlehoop", "echo '[a,b],[c]'")):
        (programs / name).write_text(f"#!/bin/sh\n{says}\n")
        (programs / name).chmod(0o755)
    return Path(shutil.copytree(LAUNCH, tmp_path / "launch"))


def say(script: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([script, *words], cwd=os.sep, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("words", "command"),
    [
        ("table2.sh seed=0,1", "+experiment=table2 seed=0,1"),
        ("full.sh", "+experiment=full"),
        ("segdep.sh steps=9", "+experiment=segdep steps=9"),
        ("rewards.sh paper seed=1", "+experiment=rewards seed=1"),
        (
            "rewards.sh results/main seed=1",
            "-m cams=[a,b],[c] reward=vlm_text,vlm_img results=results study=main seed=1",
        ),
        ("slurm.sh full seed=1", "+experiment=full hydra/launcher=slurm seed=1"),
        (
            "ray.sh table2 seed=1",
            "+experiment=table2 hydra/launcher=ray +hydra.launcher.ray.remote.num_cpus=2 seed=1",
        ),
    ],
)
def test_a_script_is_one_command_from_any_folder(scripts, words, command):
    name, *given = words.split()
    done = say(scripts / name, *given)
    assert (done.returncode, done.stdout) == (0, f"train.py {command}\n")


@pytest.mark.parametrize("name", ["rewards.sh", "slurm.sh", "ray.sh"])
def test_a_script_that_needs_a_word_shows_its_use(scripts, name):
    done = say(scripts / name)
    assert done.returncode == 2
    assert f"launch/{name} " in done.stderr


def test_nothing_is_trained_where_there_is_no_top(scripts):
    (scripts.parent / ".venv" / "bin" / "needlehoop").write_text("#!/bin/sh\nexit 2\n")
    done = say(scripts / "rewards.sh", "results/main")
    assert (done.returncode, done.stdout) == (2, "")
