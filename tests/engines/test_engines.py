"""The CPU engine, and dm_control as its oracle."""

from dataclasses import fields, replace

import pytest
import torch
from strength import ALL

from needlehoop.engines.contract import RENDERERS, EngineConfig
from needlehoop.envs import dm_control_env as dm_env
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import compose_settings
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.tasks.needle_hoop.expert import Expert

TABLE = TASK.signals

CAMS = ["cams=[dep_front,seg_side,segdep_default]"]


def same_moment(batch, single, env):
    """Assert that row ``env`` of a batch's moment is the single environment's, bit for bit."""
    for name in TABLE:
        row, value = getattr(batch.signals, name)[env], getattr(single.signals, name)[0]
        assert torch.equal(row, value), name
    for field in fields(batch):
        if field.name == "signals":
            continue
        row, value = getattr(batch, field.name), getattr(single, field.name)
        if field.name in ("terms", "facts"):
            assert all(torch.equal(row[name][env], value[name][0]) for name in row)
        else:
            assert torch.equal(row[env], value[0]), field.name


@pytest.mark.parametrize("control", ["tip", "pose"])
def test_dm_controls_face_and_the_batch_agree_bit_for_bit(control):
    words = ["num_envs=2", "seed=5", f"episode.control={control}", "episode.max_steps=30"]
    settings = compose_settings(words)
    batch, singles = build(settings), [dm_env.load(settings, env=env) for env in range(2)]
    act = controller("random", replace(settings, seed=3))
    if control == "tip":
        act = Expert(settings.task, settings.episode)
    moment, grasped = batch.reset(), False
    for single in singles:
        single.reset()
    for _ in range(45):
        action = act(moment.signals)
        moment = batch.step(action)
        grasped |= bool(moment.signals.grasped.any())
        over = moment.terminated | moment.truncated
        for env, single in enumerate(singles):
            assert single.step(action[env].numpy()).last() == bool(over[env])
            same_moment(moment, single.task.moment, env)
        if bool(over.any()):
            moment = batch.reset(over)
            for env in over.nonzero().flatten().tolist():
                singles[env].reset()
                same_moment(moment, singles[env].task.moment, env)
    assert grasped == (control == "tip")


@pytest.mark.parametrize("renderer", RENDERERS)
def test_every_world_shows_every_object_in_every_frame(renderer):
    # A render context that was spoilt at its first launch drops objects for good.
    settings = compose_settings([*CAMS, "num_envs=5", "seed=2"])
    simulation = build(replace(settings, engine=EngineConfig(2, renderer, "cpu")))
    act, moment = controller("random", replace(settings, seed=0)), simulation.reset()
    colours = settings.renderings["seg"].colours
    for _ in range(3):
        flat = simulation.images()["seg_side"].permute(0, 2, 3, 1).reshape(5, -1, 3)
        moment = simulation.step(act(moment.signals))
        for name, colour in colours.items():
            counts = (flat == torch.tensor(colour, dtype=torch.uint8)).all(-1).sum(-1)
            assert (counts >= 10).all(), (name, counts)


def test_a_needle_that_nobody_touches_stays_still():
    settings = compose_settings(["num_envs=2"])
    simulation = build(settings)
    before = simulation.reset().signals
    # 200 control steps are 2,000 physics steps; the tool stays where it is.
    for _ in range(200):
        simulation.engine.step(simulation.act(torch.zeros(2, 5)))
    after = simulation.observe().signals
    for name in ("pickup_point", "needle_tip"):
        moved = (getattr(after, name) - getattr(before, name)).norm(dim=-1)
        assert moved.max() < 1e-7, (name, moved)


@pytest.mark.parametrize("grasp", ["weld", "friction"])
def test_random_actions_at_full_amplitude_keep_the_physics_finite(grasp):
    from stability import shake

    count = 40 if ALL else 8
    settings = compose_settings([f"num_envs={count}", f"episode.grasp={grasp}"])
    report = shake(settings, episodes=count)
    assert report.not_finite == 0
    assert report.outside_table == 0
    assert report.deep_contacts < 0.005 * report.steps
