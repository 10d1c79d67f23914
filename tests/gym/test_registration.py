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


@pytest.mark.parametrize(
    "imports",
    [
        "import needlehoop, gymnasium",
        *(
            pytest.param(words, marks=pytest.mark.full)
            for words in (
                "import gymnasium, needlehoop",
                "import needlehoop, importlib.util as u\n"
                "u.find_spec('gymnasium')\nimport gymnasium",
                "import needlehoop\nfrom gymnasium.vector import VectorEnv\nimport gymnasium",
            )
        ),
    ],
)
def test_it_is_registered_in_any_order(imports):
    assert python(f"{imports}\nprint(gymnasium.spec('{ID}').id)") == ID


def test_every_task_has_its_id():
    ids = {name.removeprefix("needlehoop/") for name in gymnasium.registry if "needlehoop" in name}
    assert ids == {"NeedleHoop-v0", "Reach-v0", "PegTransfer-v0", "Handover-v0", "OwnTask-v0"}
    assert len(built_in()) == 4


@pytest.mark.parametrize(
    ("name", "task", "option"),
    [
        ("NeedleHoop", None, "standard"),
        ("NeedleHoop", "wide", "wide"),
        ("Reach", None, "reach"),
        ("Reach", "wide", "reach/wide"),
        ("PegTransfer", "peg_transfer/near", "peg_transfer/near"),
        ("Handover", "wide", "handover/wide"),
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


@pytest.mark.full
def test_its_name_is_enough():
    made = f"gymnasium.make('needlehoop:{ID}', cams=[], obs='signals')"
    entry = python(f"import gymnasium\nprint({made}.spec.entry_point)")
    assert entry == "needlehoop.api.entries:single"


def test_importing_needlehoop_imports_nothing_heavy():
    code = (
        "import sys, needlehoop\nprint({'gymnasium', 'numpy', 'torch', 'mujoco'} & {*sys.modules})"
    )
    assert python(code) == "set()"


@pytest.mark.parametrize(
    ("package", "call", "extra"),
    [
        pytest.param(
            *("gymnasium", "from needlehoop.gym.env import GymnasiumEnv", "gym"),
            marks=pytest.mark.full,
        ),
        pytest.param("gymnasium", "needlehoop.make_sb3()", "gym", marks=pytest.mark.full),
        ("stable_baselines3", "needlehoop.make_sb3()", "sb3"),
    ],
)
def test_a_forgotten_extra_is_one_line_with_the_command(package, call, extra):
    code = f"""
import sys
sys.modules["{package}"] = None
import needlehoop
try:
    {call}
except ImportError as error:
    print(error)
"""
    said = python(code)
    assert f"pip install 'needlehoop[{extra}]'" in said
    assert "\n" not in said
