"""The task can be done, and it can be faked."""

import pytest
import torch

from needlehoop import config
from needlehoop.envs.build import build
from needlehoop.envs.controllers import CONTROLLERS, controller
from needlehoop.envs.rollout import run_episodes
from needlehoop.envs.trials import run_trials
from needlehoop.scene.signals import Signals
from needlehoop.task.expert import expert
from needlehoop.task.smooth import smooth

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


@pytest.mark.parametrize("grasp", ["weld", "friction"])
@pytest.mark.parametrize("task", ["near", "standard", "wide"])
def test_the_smooth_expert_threads_the_needle(task, grasp):
    settings = config.settings([f"task={task}", f"episode.grasp={grasp}"])
    outcome = run_trials(settings, "smooth", EPISODES)
    assert outcome.threaded.double().mean() >= 0.98
    assert outcome.potential[outcome.threaded].min() >= 8.0


_READ_OFF = ("pickup_point", "needle_tip", "goal", "tool_midpoint")
"""What an agent has to see in its images."""


def _blurred(signals: Signals, sigma: float, generator: torch.Generator) -> Signals:
    """Signals with the places read off wrongly, by ``sigma`` (m) along each axis."""
    seen = signals.clone()
    for name in _READ_OFF:
        place = getattr(signals, name)
        noise = torch.randn(place.shape, generator=generator, dtype=place.dtype)
        setattr(seen, name, place + sigma * noise)
    return seen


@pytest.mark.parametrize(("script", "least", "most"), [(smooth, 0.9, 1.0), (expert, 0.0, 0.1)])
def test_only_the_smooth_expert_can_do_with_what_images_give(script, least, most):
    settings = config.settings(["num_envs=40"])
    simulation, _ = build(settings)
    generator = torch.Generator().manual_seed(0)
    script = script(settings.task, settings.episode)
    outcome = run_episodes(simulation, lambda s: script(_blurred(s, 0.002, generator)))
    assert least <= outcome.threaded.double().mean() <= most


@pytest.mark.parametrize("script", [expert, smooth])
def test_expert_actions_are_within_bounds(script):
    settings = config.settings()
    simulation, _ = build(settings)
    script = script(settings.task, settings.episode)
    moment = simulation.reset()
    for _ in range(60):
        action = script(moment.signals)
        assert action.shape == (8, 5)
        assert action.abs().max() <= 1.0
        moment = simulation.step(action)


def test_controllers_are_named():
    assert set(CONTROLLERS) == {"expert", "smooth", "cheat", "random"}
    with pytest.raises(ValueError, match=r"controller.*expert, smooth, cheat, random"):
        controller("expart", config.settings())


@pytest.mark.parametrize("script", [expert, smooth])
def test_the_expert_refuses_another_control_mode(script):
    settings = config.settings(["episode.control=pose"])
    with pytest.raises(ValueError, match=r"episode\.control"):
        script(settings.task, settings.episode)
