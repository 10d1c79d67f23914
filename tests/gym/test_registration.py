"""Gymnasium knows the environment in whatever order things are imported."""

import subprocess
import sys

import gymnasium
import pytest

import needlehoop
from needlehoop.tasks import built_in

ID = "needlehoop/NeedleHoop-v0"


def python(code):
    """Standard output of a fresh interpreter."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_every_task_has_its_id():
    ids = {name.removeprefix("needlehoop/") for name in gymnasium.registry if "needlehoop" in name}
    assert ids == {"NeedleHoop-v0", "Reach-v0", "PegTransfer-v0", "Handover-v0", "OwnTask-v0"}
    assert len(built_in()) == 4


@pytest.mark.parametrize(
    ("name", "task", "option"),
    [
        ("NeedleHoop", None, "standard"),
        ("Reach", "wide", "reach/wide"),
        ("PegTransfer", "peg_transfer/near", "peg_transfer/near"),
    ],
)
def test_an_id_is_of_a_task_and_takes_its_variants(name, task, option):
    made = gymnasium.make(f"needlehoop/{name}-v0", cams=[], obs="signals", task=task)
    same = needlehoop.make_env(task=option, num_envs=1, overrides=["obs=signals"])
    assert made.unwrapped.settings.task == same.settings.task
    assert made.unwrapped.settings.episode == same.settings.episode


def test_an_id_is_of_no_other_task():
    with pytest.raises(ValueError, match="task: 'reach' is of reach, and this id is needle_hoop's"):
        gymnasium.make(ID, cams=[], obs="signals", task="reach")


def test_importing_needlehoop_imports_nothing_heavy_and_registers_later():
    code = (
        "import sys, needlehoop\nprint({'gymnasium', 'numpy', 'torch', 'mujoco'} & {*sys.modules})"
    )
    assert python(f"{code}\nimport gymnasium\nprint(gymnasium.spec('{ID}').id)") == f"set()\n{ID}"


def test_a_forgotten_extra_is_one_line_with_the_command():
    output = python("""
import sys
sys.modules["stable_baselines3"] = None
import needlehoop
try:
    needlehoop.make_sb3()
except ImportError as error:
    print(error)
""")
    assert "pip install 'needlehoop[sb3]'" in output
    assert "\n" not in output
