"""One environment for Gymnasium: its contract, and the same bits as the other faces."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import needlehoop
from needlehoop.envs.controllers import controller

ID = "needlehoop:needlehoop/NeedleHoop-v0"


@pytest.mark.parametrize(
    "kwargs",
    [
        {"render_mode": "rgb_array", "render_size": 64},
        {"cams": ["rgb_default"], "channels": "first", "overrides": ["obs.frame_stack=2"]},
        {"cams": [], "obs": "signals", "overrides": ["obs.proprio=true", "episode.control=pose"]},
        {"cams": [], "overrides": ["obs.privileged_facts=[grasped,lifted]"]},
    ],
)
def test_gymnasium_and_stable_baselines_find_nothing_wrong(kwargs):
    env = gymnasium.make(ID, **kwargs).unwrapped
    with warnings.catch_warnings():
        if "obs" in kwargs:
            # The state has no bounds; MuJoCo's own environments get the same warning.
            warnings.filterwarnings("ignore", message=".*infinity")
        check_env(env)
    check_env_for_sb3(env)


def test_without_a_word_it_sees_the_first_run_s_cameras_channels_last():
    seen, _ = gymnasium.make(ID).reset(seed=0)
    assert {name: image.shape for name, image in seen.items()} == {
        "dep_front": (64, 64, 4),
        "seg_side": (64, 64, 3),
    }
    assert all(image.flags.c_contiguous and image.dtype == np.uint8 for image in seen.values())


def test_it_gives_the_bits_of_dm_control_and_of_torchrl():
    cams, seed, words = ["dep_front", "seg_side"], 5, ["obs.proprio=true", "obs.signals=true"]
    env = gymnasium.make(ID, cams=cams, overrides=words)
    dm = needlehoop.load(cams=cams, seed=seed, overrides=words)
    batch = needlehoop.make_env(cams=cams, seed=seed, num_envs=2, overrides=words)
    (seen, _), step, now = env.reset(seed=seed), dm.reset(), batch.reset()
    act, ended = controller("expert", batch.settings), False
    for _ in range(60):
        action = act(batch.simulation.look().signals)[0].float().numpy()
        for name, value in seen.items():
            assert np.array_equal(value, step.observation[name]), name
        for name in cams:
            assert np.array_equal(seen[name], now["pixels", name][0].permute(1, 2, 0)), name
        if ended:
            break
        seen, reward, terminated, truncated, info = env.step(action)
        step = dm.step(action)
        now["action"] = torch.from_numpy(np.stack([action, action]))
        now = batch.step(now)["next"]
        assert reward == step.reward
        assert np.float32(reward) == now["reward"][0]
        assert terminated == (step.last() and step.discount == 0) == bool(now["terminated"][0])
        assert truncated == bool(now["truncated"][0])
        for name, fact in info["facts"].items():
            assert fact == bool(now["facts", name][0]), name
        for name, term in info["terms"].items():
            assert np.float32(term) == now["terms", name][0], name
        ended = terminated or truncated
    assert terminated
    assert info["success"]
    assert not info["cheat"]


def test_a_seed_begins_over_and_without_one_episodes_differ():
    env, other = (gymnasium.make(ID, cams=[], obs="signals") for _ in range(2))
    assert not np.array_equal(env.reset()[0]["signals"], other.reset()[0]["signals"])
    first, second = env.reset(seed=7)[0]["signals"], env.reset()[0]["signals"]
    assert not np.array_equal(first, second)
    assert np.array_equal(env.reset(seed=7)[0]["signals"], first)
    assert np.array_equal(env.reset()[0]["signals"], second)
