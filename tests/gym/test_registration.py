"""Gymnasium knows the environment in whatever order things are imported."""

import subprocess
import sys

import pytest

ID = "needlehoop/NeedleHoop-v0"


def python(code):
    """Standard output of a fresh interpreter."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    "imports",
    [
        "import gymnasium, needlehoop",
        "import needlehoop, gymnasium",
        "import needlehoop, importlib.util as u; u.find_spec('gymnasium')\nimport gymnasium",
        "import needlehoop\nfrom gymnasium.vector import VectorEnv\nimport gymnasium",
    ],
)
def test_it_is_registered_in_any_order(imports):
    assert python(f"{imports}\nprint(gymnasium.spec('{ID}').id)") == ID


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
        ("gymnasium", "from needlehoop.gym.env import GymnasiumEnv", "gym"),
        ("gymnasium", "needlehoop.make_sb3()", "gym"),
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
