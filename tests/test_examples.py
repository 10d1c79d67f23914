"""Every example runs, on few steps."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def example(name):
    """An example's names, as after an import."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("gymnasium_random", {"steps": 101}),
        ("sb3_ppo", {"steps": 64, "num_envs": 8, "horizon": 8}),
        pytest.param(
            *("sb3_ppo", {"steps": 16, "num_envs": 4, "horizon": 4, "images": True}),
            marks=pytest.mark.full,
        ),
        ("cleanrl_style", {"steps": 832, "num_envs": 8, "horizon": 104}),
        ("torchrl_transforms", {"steps": 3}),
        ("own_reward", {"steps": 3}),
        ("own_camera", {}),
    ],
)
def test_it_runs(name, settings, capsys):
    example(name)["main"](**settings)
    assert capsys.readouterr().out.strip()
