"""The batched engine under Stable-Baselines3."""

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecVideoRecorder

import needlehoop
from needlehoop.envs.settings import compose_settings
from needlehoop.gym.env import GymnasiumEnv

WORDS = ["episode.max_steps=5", "image_size=36"]


def actions(steps, n):
    return np.random.default_rng(0).uniform(-1, 1, (steps, n, 5)).astype(np.float32)


def test_one_environment_gives_what_their_own_wrapper_gives():
    settings = compose_settings(["cams=[dep_front]", *WORDS])
    reference = DummyVecEnv([lambda: GymnasiumEnv(settings, "first")])
    ours = needlehoop.make_sb3(["dep_front"], num_envs=1, overrides=WORDS)
    assert ours.observation_space == reference.observation_space
    for env in (ours, reference):
        env.seed(4)
    assert np.array_equal(ours.reset()["dep_front"], reference.reset()["dep_front"])
    assert {**reference.reset_infos[0], "is_success": False} == ours.reset_infos[0]
    for step, action in enumerate(actions(12, 1), 1):
        seen, reward, done, (info,) = ours.step(action)
        other_seen, other_reward, other_done, (other,) = reference.step(action)
        assert np.array_equal(seen["dep_front"], other_seen["dep_front"])
        assert np.array_equal(reward, other_reward)
        assert reward.dtype == other_reward.dtype
        assert np.array_equal(done, other_done)
        assert done[0] == (step % 5 == 0)
        last, other_last = (i.pop("terminal_observation", {}) for i in (info, other))
        assert last.keys() == other_last.keys()
        assert all(np.array_equal(last[name], other_last[name]) for name in last)
        assert info.pop("is_success") is info["success"]
        assert info.pop("TimeLimit.truncated", False) is other.pop("TimeLimit.truncated")
        assert info == other


def test_it_films_the_scene_as_their_recorder_asks(tmp_path):
    env = needlehoop.make_sb3(num_envs=2, overrides=WORDS, render_mode="rgb_array")
    film = VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=2)
    film.reset()
    for action in actions(3, 2):
        film.step(action)
    film.close()
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]
