"""The example of a task from outside, with a robot of its own, obeys the contract."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from needlehoop.config import own_folder
from needlehoop.engines.contract import KINDS
from needlehoop.envs import settings as settings_module
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.envs.simulation import Simulation
from needlehoop.tasks import registry

FOLDER = Path(__file__).parents[1] / "examples/own_task"


@pytest.fixture
def task(monkeypatch):
    """The example, known by its name for as long as a test runs."""
    place = [str(FOLDER)]
    spec = importlib.util.spec_from_file_location(
        "own_task", FOLDER / "__init__.py", submodule_search_locations=place
    )
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "own_task", module)
    spec.loader.exec_module(module)
    known = registry.find
    found = {module.TASK.name: module.TASK}
    for room in (registry, settings_module):
        monkeypatch.setattr(room, "find", lambda name: found.get(name) or known(name))
    # It takes the options episode=default and reward=human for files that are there twice.
    monkeypatch.setattr(own_folder, "_check", lambda folder: None)
    return module.TASK


def built(task, *words: str) -> tuple[Simulation, object]:
    words = (f"conf_dir={FOLDER / 'conf'}", "task=cube_on_spot", "reward=sparse", *words)
    settings: Settings = compose_settings(words)
    colours = {name: one.colour for name, one in task.classes.items()}
    painted = {
        name: replace(one, colours=colours) if one.colours else one
        for name, one in settings.renderings.items()
    }
    simulation, imager = build(replace(settings, renderings=painted))
    simulation.reward = task.human(scale=0.02)
    return simulation, imager


def expert_of(task, simulation: Simulation):
    return task.controllers["expert"](simulation.layout, simulation.episode)


def test_it_is_short():
    lines = [line for file in FOLDER.glob("*.py") for line in file.read_text().splitlines()]
    assert sum(bool(line.strip()) for line in lines) <= 250


def test_the_expert_puts_the_cube_on_the_spot(task):
    simulation, _ = built(task, "num_envs=200", "seed=4000")
    act, moment = expert_of(task, simulation), simulation.reset()
    assert not moment.facts["success"].any()
    done = moment.facts["success"].clone()
    for _ in range(simulation.episode.max_steps):
        moment = simulation.step(act(moment.signals))
        now = moment.facts["success"]
        assert (moment.potential[now] > 6.0).all()
        assert (moment.potential[~now] < 4.0).all()
        done |= now
        if bool(done.all()):
            break
    assert done.double().mean() >= 0.99


def test_a_cube_held_over_the_spot_is_not_placed(task):
    simulation, _ = built(task, "num_envs=20")
    act, moment = expert_of(task, simulation), simulation.reset()
    for _ in range(simulation.episode.max_steps):
        action = act(moment.signals)
        # It never lets go of what it holds.
        action[:, 3] = torch.where(moment.signals.held, -1.0, action[:, 3])
        moment = simulation.step(action)
        assert not moment.facts["success"].any()
    assert moment.facts["has_held"].all()


def test_random_actions_keep_the_physics_finite(task):
    simulation, _ = built(task, "num_envs=40")
    generator = torch.Generator().manual_seed(0)
    simulation.reset()
    for step in range(150):
        if step % 5 == 0:
            action = 2.0 * torch.randint(0, 2, (40, 4), generator=generator).double() - 1.0
        moment = simulation.step(action)
        assert torch.isfinite(moment.signals.cube).all()
        assert all(np.isfinite(simulation.engine.data(env).qvel).all() for env in range(40))
        over = moment.terminated | moment.truncated
        if bool(over.any()):
            simulation.reset(over)


def test_both_engines_have_the_same_bits(task):
    words = ["num_envs=2", "cams=[dep_front,seg_side]", "image_size=24", "engine.threads=1"]
    (one, look_one), (other, look_other) = (built(task, *words, f"engine={kind}") for kind in KINDS)
    act, moment = expert_of(task, one), one.reset()
    other.reset()
    for _ in range(30):
        action = act(moment.signals)
        moment, same = one.step(action), other.step(action)
        assert torch.equal(moment.reward, same.reward)
        assert torch.equal(one.engine.sensordata(), other.engine.sensordata())
    assert moment.facts["has_held"].all()
    images, again = look_one(one.engine.render()), look_other(other.engine.render())
    assert all(torch.equal(images[name], again[name]) for name in images)
