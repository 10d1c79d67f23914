"""The environment's two faces: TorchRL and dm_control."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

import needlehoop
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.tasks.needle_hoop import TASK


@pytest.mark.parametrize(
    ("cams", "overrides"),
    [
        (["dep_front", "seg_side"], ["obs.proprio=true", "obs.privileged_facts=[lifted]"]),
        (["rgb_default"], ["episode.control=pose", "reward=sparse"]),
        ([], ["obs.signals=true", "episode.grasp=friction", "psm=serial"]),
    ],
)
def test_specs_hold(cams, overrides):
    env = needlehoop.make_env(cams=cams, num_envs=3, overrides=overrides)
    check_env_specs(env)


def test_a_masked_reset_renews_only_what_it_names():
    env = needlehoop.make_env(cams=["seg_side"], num_envs=6, overrides=["obs.signals=true"])
    env.reset()
    action = torch.full((6, 5), 0.5)
    for _ in range(10):
        stepped = env.step(env.full_action_spec.zero().set("action", action))["next"]
    mask = torch.tensor([False, True, False, False, False, False]).unsqueeze(-1)
    renewed = env.reset(stepped.clone().set("_reset", mask))
    kept = ~mask.squeeze(-1)
    for key in (("pixels", "seg_side"), "signals", "potential"):
        assert torch.equal(renewed[key][kept], stepped[key][kept]), key
        assert not torch.equal(renewed[key][~kept], stepped[key][~kept]), key


def test_the_return_is_the_last_potential_and_a_time_out_does_not_terminate():
    env = needlehoop.make_env(num_envs=3, overrides=["episode.max_steps=25"])
    rollout = env.rollout(40)
    assert rollout.shape == (3, 25)
    assert rollout["next", "truncated"][:, -1].all()
    assert not rollout["next", "terminated"].any()
    total = rollout["next", "reward"].sum(1)
    torch.testing.assert_close(total, rollout["next", "potential"][:, -1], atol=1e-5, rtol=0)
    terms = sum(rollout["next", "terms"][:, -1].values())
    torch.testing.assert_close(terms, rollout["next", "potential"][:, -1], atol=1e-5, rtol=0)


def test_staggered_first_episodes_end_one_after_the_other():
    settings = compose_settings(["episode.max_steps=8"])
    env = TorchRLEnv(replace(settings, num_envs=4), stagger=True)
    rollout = env.rollout(16, break_when_any_done=False)
    ends = [ended.nonzero().flatten().tolist() for ended in rollout["next", "truncated"][..., 0]]
    assert ends == [[7, 15], [5, 13], [3, 11], [1, 9]]


def test_set_seed_starts_the_seed_over():
    env = needlehoop.make_env(num_envs=2, overrides=["obs.signals=true"])
    env.set_seed(11)
    first = env.reset()["signals"].clone()
    assert not torch.equal(env.reset()["signals"], first)
    env.set_seed(11)
    assert torch.equal(env.reset()["signals"], first)


def test_signals_and_privileged_facts_come_in_their_order():
    words = ["obs.privileged_facts=[lifted,grasped]", "obs.signals=true"]
    env = needlehoop.make_env(num_envs=2, overrides=words)
    state = env.reset()
    signals = env.simulation.look().signals
    columns = [getattr(signals, name).float().reshape(2, -1) for name in TASK.state]
    assert torch.equal(state["signals"], torch.cat(columns, -1))
    expert = controller("smooth", env.settings)
    rows = []
    for _ in range(18):
        state["action"] = expert(env.simulation.look().signals).float().clamp(-1, 1)
        state = env.step(state)["next"]
        facts = state["facts"]
        expected = torch.cat((facts["lifted"], facts["grasped"]), -1).float()
        assert torch.equal(state["privileged_facts"], expected)
        rows.append(state["privileged_facts"][0].tolist())
    # Held before it is lifted, so that the order can be seen.
    assert [0.0, 1.0] in rows
    assert [1.0, 1.0] in rows


def test_dm_control_tells_of_observations_before_a_reset_and_ends_with_discount_one():
    for overrides in (
        ["obs.signals=true"],
        ["obs.proprio=true", "obs.privileged_facts=[lifted]"],
        [],
    ):
        cams = ["dep_front"] if overrides else []
        env = needlehoop.load(cams=cams, overrides=["episode.max_steps=3", *overrides])
        spec = env.observation_spec()
        seen = env.reset().observation
        assert {k: (v.shape, v.dtype) for k, v in spec.items()} == {
            k: (v.shape, v.dtype) for k, v in seen.items()
        }
        steps = [env.step(np.zeros(5)) for _ in range(3)]
        assert [(step.last(), step.discount) for step in steps] == [*[(False, 1)] * 2, (True, 1)]


def test_stacked_frames_are_the_last_ones_and_a_new_episode_repeats_its_first():
    words = ["obs.frame_stack=3", "episode.max_steps=4"]
    one = needlehoop.make_env(cams=["seg_side"], num_envs=2, overrides=words[1:])
    three = needlehoop.make_env(cams=["seg_side"], num_envs=2, overrides=words)
    plain, stacked = one.reset(), three.reset()
    seen = [plain["pixels", "seg_side"]] * 3
    for step in range(1, 7):
        assert torch.equal(stacked["pixels", "seg_side"], torch.cat(seen[-3:], 1)), step
        action = torch.full((2, 5), 0.7)
        plain["action"], stacked["action"] = action, action.clone()
        _, plain = one.step_and_maybe_reset(plain)
        _, stacked = three.step_and_maybe_reset(stacked)
        image = plain["pixels", "seg_side"]
        seen = [image] * 3 if step == 4 else [*seen, image]


@pytest.mark.parametrize("disturb", ["none", "severe"])
def test_a_restored_environment_goes_on_with_the_same_bits(disturb):
    words = ["episode.max_steps=9", "obs.frame_stack=2", "obs.proprio=true", "obs.signals=true"]
    words.append(f"disturb={disturb}")
    first, second = (
        needlehoop.make_env(cams=["dep_front"], num_envs=3, overrides=words) for _ in range(2)
    )
    generator = torch.Generator().manual_seed(0)
    actions = 2 * torch.rand(30, 3, 5, generator=generator) - 1
    now = first.reset()
    for action in actions[:14]:
        _, now = first.step_and_maybe_reset(now.set("action", action))
    second.load_state_dict(first.state_dict())
    again = second.reset()
    for action in actions[14:]:
        whole, now = first.step_and_maybe_reset(now.set("action", action))
        resumed, again = second.step_and_maybe_reset(again.set("action", action))
        assert (whole["next"] == resumed["next"]).all()
