"""The task can be done, and it can be faked."""

import pytest
import torch

from needlehoop import config
from needlehoop.envs.controllers import CONTROLLERS, controller
from needlehoop.envs.trials import run_trials
from needlehoop.task.expert import expert

EPISODES = 200


@pytest.mark.parametrize(("grasp", "rate"), [("weld", 0.98), ("friction", 0.90)])
def test_the_expert_threads_the_needle(grasp, rate):
    outcome = run_trials(config.settings([f"episode.grasp={grasp}"]), "expert", EPISODES)
    assert outcome.threaded.double().mean() >= rate
    done = outcome.potential[outcome.threaded]
    assert done.min() >= 8.0
    assert done.max() <= 9.2


@pytest.mark.parametrize("task", ["near", "wide"])
def test_the_expert_manages_the_other_difficulties(task):
    outcome = run_trials(config.settings([f"task={task}"]), "expert", 60)
    assert outcome.threaded.double().mean() >= 0.95


def test_the_cheat_touches_the_goal_and_is_told_apart():
    # The geometry allows it: the tip comes within the goal's radius before the opening.
    outcome = run_trials(config.settings(), "cheat", 40)
    assert outcome.touched.double().mean() >= 0.9
    assert not outcome.threaded.any()
    assert torch.equal(outcome.cheat, outcome.touched)


def test_chance_does_not_thread_the_needle():
    outcome = run_trials(config.settings(), "random", 40)
    assert not outcome.threaded.any()
    assert outcome.potential.mean() < 2.0


def test_trials_do_not_depend_on_how_many_there_are():
    few, many = (run_trials(config.settings(), "expert", n) for n in (3, 9))
    assert torch.equal(few.potential, many.potential[:3])


def test_expert_actions_are_within_bounds():
    from needlehoop.envs.build import build

    settings = config.settings()
    simulation, _ = build(settings)
    script = expert(settings.task, settings.episode)
    moment = simulation.reset()
    for _ in range(60):
        action = script(moment.signals)
        assert action.shape == (8, 5)
        assert action.abs().max() <= 1.0
        moment = simulation.step(action)


def test_controllers_are_named():
    assert set(CONTROLLERS) == {"expert", "cheat", "random"}
    with pytest.raises(ValueError, match=r"controller.*expert, cheat, random"):
        controller("expart", config.settings())


def test_the_expert_refuses_another_control_mode():
    settings = config.settings(["episode.control=pose"])
    with pytest.raises(ValueError, match=r"episode\.control"):
        expert(settings.task, settings.episode)
