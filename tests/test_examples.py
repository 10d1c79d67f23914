"""Every example runs, on few steps."""

import runpy
from pathlib import Path

import pytest
import torch

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


def test_the_transforms_keep_images_images():
    made = example("torchrl_transforms")
    env = made["make"](num_envs=2, frames=3)
    image = env.reset()["pixels", "dep_front"]
    assert image.shape == (2, 12, 64, 64)
    assert image.dtype == torch.float32
    assert 0 <= image.min() <= image.max() <= 1
    rollout = env.rollout(5)
    stacked = rollout["pixels", "dep_front"]
    # The newest frame last: what was newest is in the middle a step later.
    assert torch.equal(stacked[:, :-1, 8:], stacked[:, 1:, 4:8])
    assert rollout["next", "step_count"][0, -1] == 5
    torch.testing.assert_close(
        rollout["next", "episode_reward"][:, -1], rollout["next", "potential"][:, -1]
    )
