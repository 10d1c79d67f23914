"""Environments in lockstep for Gymnasium: its three ways of resetting, and TorchRL's bits."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import needlehoop

ID = "needlehoop:needlehoop/NeedleHoop-v0"
NEXT, SAME, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED


def make(n=3, mode=NEXT, cams=("seg_side",), words=("obs.signals=true",), max_steps=4):
    overrides = [*words, f"episode.max_steps={max_steps}", "image_size=32"]
    return gymnasium.make_vec(
        ID, num_envs=n, cams=list(cams), overrides=overrides, autoreset_mode=mode
    )


def actions(steps, n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, n, 5)).astype(np.float32)


@pytest.mark.parametrize(("mode", "stack"), [(NEXT, 1), (SAME, 3)])
def test_one_environment_gives_what_gymnasium_s_own_vector_environment_gives(mode, stack):
    words = ["obs.signals=true", f"obs.frame_stack={stack}"]
    ours = make(1, mode, words=words)
    kwargs = {
        "cams": ["seg_side"],
        "overrides": [*words, "episode.max_steps=4", "image_size=32"],
    }
    reference = SyncVectorEnv([lambda: gymnasium.make(ID, **kwargs)], autoreset_mode=mode)
    assert ours.observation_space == reference.observation_space
    assert data_equivalence(ours.reset(seed=3), reference.reset(seed=3), exact=True)
    for action in actions(11, 1):
        step, expected = ours.step(action), reference.step(action)
        assert data_equivalence(step, expected, exact=True)


def test_it_gives_the_bits_of_torchrl():
    words = ["obs.signals=true", "obs.frame_stack=2"]
    env = make(3, SAME, cams=["dep_front"], words=words, max_steps=5)
    reference = needlehoop.make_env(
        cams=["dep_front"],
        num_envs=3,
        seed=8,
        overrides=[*words, "episode.max_steps=5", "image_size=32"],
    )
    seen, _ = env.reset(seed=8)
    now = reference.reset()
    for step, action in enumerate(actions(12, 3), 1):
        compare(seen, now)
        now["action"] = torch.from_numpy(action)
        whole, now = reference.step_and_maybe_reset(now)
        seen, rewards, terminated, truncated, infos = env.step(action)
        assert np.array_equal(rewards.astype(np.float32), whole["next", "reward"][:, 0])
        assert np.array_equal(truncated, whole["next", "truncated"][:, 0])
        assert not terminated.any()
        if step % 5:
            continue
        final = {k: np.stack([obs[k] for obs in infos["final_obs"]]) for k in seen}
        compare(final, whole["next"])
        potential = infos["final_info"]["potential"].astype(np.float32)
        assert np.array_equal(potential, whole["next", "potential"][:, 0])
        assert infos["_final_obs"].all()


def compare(seen, tensordict):
    assert np.array_equal(seen["signals"], tensordict["signals"])
    pixels = tensordict["pixels", "dep_front"].permute(0, 2, 3, 1)
    assert np.array_equal(seen["dep_front"], pixels)


@pytest.mark.parametrize("mode", [NEXT, SAME, DISABLED])
def test_environments_that_end_at_different_times_do_not_disturb_each_other(mode):
    """One that is reset beside others steps on as if it were alone."""
    env, alone = make(2, mode, max_steps=6), make(2, DISABLED, max_steps=6)
    seen, _ = env.reset(seed=1)
    calm, _ = alone.reset(seed=1)
    moves = actions(5, 2)
    for action in moves[:2]:
        seen, *_ = env.step(action)
        calm, *_ = alone.step(action)
    # Environment 0 begins anew; environment 1 is two steps ahead of it from here on.
    mask = np.array([True, False])
    seen, infos = env.reset(options={"reset_mask": mask})
    assert infos["_steps"].tolist() == [True, False]
    assert np.array_equal(seen["seg_side"][1], calm["seg_side"][1])
    assert not np.array_equal(seen["seg_side"][0], calm["seg_side"][0])
    ends = []
    for action in moves[2:]:
        seen, rewards, _, truncated, _ = env.step(action)
        calm, paid, *_ = alone.step(action)
        assert rewards[1] == paid[1]
        assert np.array_equal(seen["signals"][1], calm["signals"][1])
        assert np.array_equal(seen["seg_side"][1], calm["seg_side"][1])
        ends.append(truncated.tolist())
    assert ends == [[False, False]] * 3
    *_, truncated, infos = env.step(moves[0])
    assert truncated.tolist() == [False, True]
    if mode == SAME:
        assert infos["steps"].tolist() == [4, 0]
        assert infos["final_info"]["steps"].tolist() == [0, 6]
        assert infos["final_obs"][0] is None
        assert infos["final_obs"][1] in env.single_observation_space
    elif mode == NEXT:
        # The second action is nobody's, whatever it is.
        _, rewards, *ended, infos = env.step(np.array([moves[0][0], [np.nan] * 5]))
        assert infos["steps"].tolist() == [5, 0]
        assert not any(value[1] for value in (rewards, *ended))
    else:
        with pytest.raises(ResetNeeded, match=r"\[1\]"):
            env.step(moves[0])


def test_what_is_handed_out_is_the_caller_s():
    env, twin = make(2, SAME), make(2, SAME)
    for e in (env, twin):
        e.reset(seed=0)
    for action in actions(9, 2):
        seen, _, _, _, infos = env.step(action)
        for value in seen.values():
            value[:] = 0
        for value in infos["facts"].values():
            value[:] = True
        same = twin.step(action)
    last = env.step(actions(1, 2)[0])
    assert data_equivalence(last, twin.step(actions(1, 2)[0]), exact=True)
    assert same[0]["seg_side"].any()


def test_pictures_are_of_each_environment_as_it_is_now():
    env = gymnasium.make_vec(
        ID, num_envs=2, cams=["seg_side"], render_mode="rgb_array", render_size=48
    )
    env.reset(seed=0)
    first, second = env.render()
    assert first.shape == second.shape == (48, 48, 3)
    assert not np.array_equal(first, second)
    for _ in range(8):
        env.step(np.array([[-1, 0, 0, 0, 0]] * 2))
    assert (env.render()[0] != first).any(-1).mean() > 0.01


def test_a_mistake_is_told_by_its_key():
    for kwargs, message in (
        ({"autoreset_mode": "Never"}, "'Never' is unknown; choose from NextStep, SameStep"),
        ({"cams": []}, "cams: nothing is observed"),
    ):
        with pytest.raises(ValueError, match=message):
            gymnasium.make_vec(ID, **{"num_envs": 2, "cams": ["seg_side"], **kwargs})
    env = make(2)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((2, 5)))
    env.reset(seed=0)
    with pytest.raises(InvalidAction, match=r"action: shape \(5,\); expected \(2, 5\)"):
        env.step(np.zeros(5))
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=1, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="options: 'start' is unknown; choose from reset_mask"):
        env.reset(options={"start": "here"})
