"""Disturbed environments: the same bits everywhere, and nothing without amounts."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.torchrl_env import TorchRLEnv

CAMS = "cams=[rgb_front,dep_front,seg_side]"
COLOURS = (
    *("picture.brightness=0.5", "scene.colours=0.5", "scene.sheen=0.5", "scene.lamp=40"),
    *("scene.texture=0.5", "scene.strength=0.5"),
)
"""They show in colours, and neither in depth nor in flat colours."""
SEVERE = (CAMS, "num_envs=3", "seed=5", "disturb=severe", "image_size=32")


def flown(*words: str, steps: int = 25, first: int = 0) -> tuple[list, list]:
    """Sensor data and images of a few steps of the expert's."""
    settings = compose_settings(words)
    simulation = build(settings, first)
    moment, act = simulation.reset(), controller("smooth", settings)
    felt, seen = [], [simulation.images()]
    for _ in range(steps):
        moment = simulation.step(act(moment.signals).clamp(-1, 1))
        felt.append(simulation.engine.sensordata())
        seen.append({name: image.clone() for name, image in simulation.images().items()})
        done = moment.terminated | moment.truncated
        if bool(done.any()):
            moment = simulation.reset(done)
    return felt, seen


def same(first: list, second: list, rows: slice = slice(None)) -> bool:
    return all(
        torch.equal(a[rows], b)
        if isinstance(a, torch.Tensor)
        else all(torch.equal(a[name][rows], b[name]) for name in a)
        for a, b in zip(first, second, strict=True)
    )


@pytest.fixture(scope="module")
def severe() -> tuple[list, list]:
    return flown(*SEVERE)


@pytest.mark.parametrize("word", ["engine.threads=3", "engine=dm_control"])
def test_the_same_bits_on_any_engine_with_any_threads(severe, word):
    for expected, actual in zip(severe, flown(*SEVERE, word), strict=True):
        assert same(expected, actual)


def test_an_environment_is_disturbed_alike_in_any_batch(severe):
    for expected, actual in zip(severe, flown(*SEVERE, "num_envs=1", first=1), strict=True):
        assert same(expected, actual, slice(1, 2))


def test_none_dealt_is_as_if_there_were_nothing():
    plain = build(compose_settings([*SEVERE, "disturb=none"]))
    none = build(compose_settings(SEVERE))
    none.deal(torch.arange(3), torch.arange(3), {})
    plain.reset(), none.reset()
    action = torch.rand(3, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for _ in range(5):
        plain.step(action), none.step(action)
        assert torch.equal(plain.engine.sensordata(), none.engine.sensordata())
        seen, same = plain.images(), none.images()
        assert all(torch.equal(seen[name], same[name]) for name in seen)


@pytest.mark.parametrize(
    ("word", "views"),
    [
        *((word, {"rgb_front", "dep_front"}) for word in COLOURS),
        ("picture.depth_noise=0.01", {"dep_front"}),
        ("picture.labels=0.5", {"seg_side"}),
        ("camera.focal=0.2", {"rgb_front", "dep_front", "seg_side"}),
        ("camera.turn=3", {"rgb_front", "dep_front", "seg_side"}),
    ],
)
def test_an_axis_shows_in_the_cameras_that_it_touches(word, views):
    words = (CAMS, "num_envs=1", "seed=2")
    plain = flown(*words, steps=0)[1][0]
    disturbed = flown(*words, f"disturb.{word}", steps=0)[1][0]
    assert {name for name in plain if not torch.equal(plain[name], disturbed[name])} == views


def test_each_view_is_as_many_steps_late_as_it_drew():
    words = (CAMS, "num_envs=2", "seed=4", "image_size=32")
    plain, delayed = flown(*words, steps=8)[1], flown(*words, "disturb.picture.late=3", steps=8)[1]
    simulation = build(compose_settings([*words, "disturb.picture.late=3"]))
    simulation.reset()
    late = simulation.disturbance._drawn["picture.late"].amount[..., 0].int().numpy()
    assert len(np.unique(late)) > 1
    for step, images in enumerate(delayed):
        for env in range(2):
            for name, view in (("dep_front", 0), ("seg_side", 1)):
                then = plain[max(0, step - late[env, view])]
                assert torch.equal(images[name][env], then[name][env]), (step, env, name)


@pytest.mark.parametrize(("task", "arms"), [("standard", [""]), ("handover", ["psm1_", "psm2_"])])
def test_the_tip_stands_beside_where_it_was_told_to(task, arms):
    settings = compose_settings([f"task={task}", "num_envs=2", "disturb.robot.offset=0.005"])
    simulation = build(settings)
    simulation.reset()
    still = torch.zeros(2, settings.episode.action_size, dtype=torch.float64)
    for _ in range(15):
        moment = simulation.step(still)
    offset = simulation.disturbance.offset
    assert float(offset.abs().max()) > 1e-3
    for arm in arms:
        tool = getattr(moment.signals, f"{arm}tool_midpoint")
        beside = tool - simulation.state[f"{arm}target"]
        assert float((beside - offset).abs().max()) < 5e-4


def test_commands_come_late_and_the_ramp_grows():
    settings = compose_settings(["num_envs=64", "disturb.robot.late=3", "disturb.ramp=0.5"])
    env = TorchRLEnv(settings, length=4)
    now = env.reset()
    disturbance = env.simulation.disturbance
    assert not disturbance._drawn["robot.late"].amount.any()
    levels = []
    for seed in range(1, 5):
        env.step(now.set("action", torch.zeros(64, 5)))
        env.set_seed(seed)
        now = env.reset()
        levels.append(disturbance.level)
    assert levels == [0.5, 1.0, 1.0, 1.0]
    late = disturbance._drawn["robot.late"].amount[:, 0]
    assert set(late.tolist()) == {0.0, 1.0, 2.0, 3.0}
    # The first command that differs from the one before: at once where nothing is late.
    action = torch.zeros(64, 5)
    action[:, 0] = 1.0
    sent = [env.simulation.act(action.double()).clone() for _ in range(4)]
    moved = torch.stack([(one != sent[0]).any(1) for one in sent])
    first = torch.where(moved.any(0), moved.int().argmax(0), 4)
    assert torch.equal(first, late.long().clamp(min=1))
