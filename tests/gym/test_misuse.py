"""What users get wrong: each mistake is one line, of Gymnasium's kinds or a ``ValueError``."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import Error, InvalidAction, ResetNeeded

import needlehoop
from needlehoop.envs.settings import compose_settings
from needlehoop.gym.env import GymnasiumEnv
from needlehoop.gym.stable_baselines import StableBaselinesVecEnv
from needlehoop.gym.vector import GymnasiumVectorEnv
from needlehoop.pictures.stills import portrait

ID = "needlehoop:needlehoop/NeedleHoop-v0"
BLIND = {"cams": [], "overrides": ["obs.signals=true", "engine.threads=1"]}


def gym(**kwargs):
    return gymnasium.make(ID, **kwargs)


def vector(**kwargs):
    return gymnasium.make_vec(ID, num_envs=2, **kwargs)


FACES = [needlehoop.make_env, needlehoop.load, needlehoop.make_sb3, gym, vector]

SETTINGS = [
    ({"overrides": ["image_size=10000000"]}, "image_size: 10000000 must be at most 2048"),
    ({"reward": 3}, "reward: 3 is no option"),
    ({"conf_dir": 3}, "conf_dir: .*3' is no folder"),
]


@pytest.mark.parametrize("face", FACES, ids=["make_env", "load", "make_sb3", "gym", "vector"])
def test_a_setting_of_another_kind_is_a_value_error_on_every_face(face):
    for kwargs, message in SETTINGS:
        with pytest.raises(ValueError, match=message) as caught:
            face(**kwargs)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [0, 4097, 10**30, 64.5, True, None])
@pytest.mark.filterwarnings("ignore:.*The environment is being initialised with render_mode")
def test_a_picture_s_size_is_bounded_on_every_face(size):
    settings = compose_settings(["cams=[seg_side]", "num_envs=1", "engine.threads=1"])
    for make in (gym, vector):
        with pytest.raises(ValueError, match="render_size: ") as caught:
            make(cams=["seg_side"], render_mode="rgb_array", render_size=size)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="size: "):
        portrait(settings, size)


def test_a_run_has_settings_of_its_own():
    with pytest.raises(ValueError, match="run: its environment has settings of its own"):
        gym(run="results/main", cams=["seg_side"])


ACTIONS = [
    np.zeros(5, complex),
    np.zeros(4),
    np.zeros((5, 1)),
    np.array(["up"] * 5),
    np.zeros(5, bool),
    "up",
    None,
    [0, 0],
]


def test_an_action_that_is_none_is_gymnasium_s_invalid_action():
    env = GymnasiumEnv(compose_settings(["cams=[]", *BLIND["overrides"]]))
    many = GymnasiumVectorEnv(compose_settings(["cams=[]", "num_envs=2", *BLIND["overrides"]]))
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(5))
    env.reset(seed=0)
    many.reset(seed=0)
    for action in ACTIONS:
        with pytest.raises(InvalidAction, match=r"action: .* expected real numbers"):
            env.step(action)
        with pytest.raises(InvalidAction, match=r"action: .* expected real numbers"):
            many.step(np.asarray(action)[None].repeat(2, 0))
    env.step(np.zeros(5, int))
    with pytest.raises(ValueError, match="action: not finite"):
        env.step(np.full(5, np.nan))


@pytest.mark.parametrize("options", [{"start": "here"}, {3: 4}, [1], 3])
def test_options_that_are_not_there_are_gymnasium_s_error(options):
    for env in (gym(**BLIND), vector(**BLIND)):
        with pytest.raises(Error, match="options: ") as caught:
            env.unwrapped.reset(options=options)
        assert "\n" not in str(caught.value)
        env.unwrapped.reset(options={})


def test_stable_baselines_needs_a_reset_first():
    env = StableBaselinesVecEnv(compose_settings(["cams=[]", *BLIND["overrides"]]))
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((8, 5)))


FORKED = """
    import sys
    import gymnasium, needlehoop
    from gymnasium.vector import AsyncVectorEnv

    def make():
        words = ["image_size=16", "engine.threads=2"]
        return gymnasium.make("needlehoop/NeedleHoop-v0", cams=["seg_side"], overrides=words)

    if __name__ == "__main__":
        env = make()
        env.reset(seed=0)
        env.step(env.action_space.sample())
        vector = AsyncVectorEnv([make], context=sys.argv[1])
        seen, _ = vector.reset(seed=0)
        print(seen["seg_side"].shape)
        vector.close()
"""


@pytest.mark.parametrize(
    ("context", "said"),
    [
        ("fork", 'context="spawn"'),
        pytest.param("spawn", "(1, 16, 16, 3)", marks=pytest.mark.full),
    ],
)
@pytest.mark.full
def test_processes_beside_a_used_environment(tmp_path, context, said):
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(FORKED))
    done = subprocess.run(
        [sys.executable, script, context],
        env={**os.environ, "PYTHONPATH": str(Path(needlehoop.__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert said in done.stdout + done.stderr
