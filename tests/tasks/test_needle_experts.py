"""The task can be done, and it can be faked."""

import pytest
import torch
from strength import ALL
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller, controllers, run_trials
from needlehoop.envs.rollout import run_episodes
from needlehoop.envs.settings import compose_settings
from needlehoop.scene.signals import Signals
from needlehoop.tasks.needle_hoop.expert import Script, expert, smooth

EPISODES = 200 if ALL else 60


@pytest.mark.parametrize(("grasp", "rate"), [("weld", 0.98), ("friction", 0.90)])
def test_the_expert_threads_the_needle(grasp, rate):
    outcome = run_trials(compose_settings([f"episode.grasp={grasp}"]), "expert", EPISODES)
    assert outcome.facts["threaded"].double().mean() >= rate
    done = outcome.potential[outcome.facts["threaded"]]
    assert done.min() >= 8.0
    assert done.max() <= 9.2


@pytest.mark.parametrize("task", ["near", "wide"])
def test_the_expert_manages_the_other_difficulties(task):
    outcome = run_trials(compose_settings([f"task={task}"]), "expert", 60)
    assert outcome.facts["threaded"].double().mean() >= 0.95


def test_the_cheat_touches_the_goal_and_is_told_apart():
    # The geometry allows it: the tip comes within the goal's radius before the opening.
    outcome = run_trials(compose_settings(), "cheat", 40)
    assert outcome.facts["touched"].double().mean() >= 0.9
    assert not outcome.facts["threaded"].any()
    assert torch.equal(outcome.facts["cheat"], outcome.facts["touched"])


def test_chance_does_not_thread_the_needle():
    outcome = run_trials(compose_settings(), "random", 40)
    assert not outcome.facts["threaded"].any()
    assert outcome.potential.mean() < 2.0


def test_trials_do_not_depend_on_how_many_there_are():
    few, many = (run_trials(compose_settings(), "expert", n) for n in (3, 9))
    assert torch.equal(few.potential, many.potential[:3])


@pytest.mark.parametrize("grasp", ["weld", "friction"])
@pytest.mark.parametrize("task", ["near", "standard", "wide"])
def test_the_smooth_expert_threads_the_needle(task, grasp):
    settings = compose_settings([f"task={task}", f"episode.grasp={grasp}"])
    outcome = run_trials(settings, "smooth", EPISODES)
    assert outcome.facts["threaded"].double().mean() >= 0.98
    # It is still on its way through when the episode ends.
    assert outcome.potential[outcome.facts["threaded"]].min() >= 7.4


def _blurred(signals: Signals, bias: Tensor, sigma: float, generator: torch.Generator) -> Signals:
    """Signals as read off small images.

    Places of the needle are off by ``bias`` and, as angles of the jaws (rad, for mm) are, by
    ``sigma`` in m along each axis; whether almost shut jaws hold the needle is a guess.
    """
    seen = signals.clone()

    def noise(like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=generator, dtype=like.dtype)

    seen.pickup_point = signals.pickup_point + bias + sigma * noise(signals.pickup_point)
    seen.needle_tip = signals.needle_tip + bias + sigma * noise(signals.needle_tip)
    turned = 70.0 * sigma * noise(signals.jaw)
    seen.jaw, seen.jaw_command = signals.jaw + turned, signals.jaw_command + turned
    near = (signals.pickup_point - signals.tool_midpoint).norm(dim=-1) < 0.006
    unsure = near & (signals.jaw < 0.45) & (torch.rand(near.shape, generator=generator) < 0.4)
    seen.grasped = signals.grasped ^ unsure
    return seen


def _guessed(
    script: Script, signals: Signals, bias: Tensor, sigma: float, generator: torch.Generator
) -> Tensor:
    """What a script would do on average over what images leave open."""
    guesses = [script(_blurred(signals, bias, sigma, generator)) for _ in range(16)]
    return torch.stack(guesses).mean(0)


@pytest.mark.parametrize(("script", "least", "most"), [(smooth, 0.9, 1.0), (expert, 0.0, 0.2)])
def test_only_the_smooth_expert_can_do_with_what_images_give(script, least, most):
    # A learner does what the expert would do on average over what may be there, and is wrong
    # about it in the same way throughout an episode.
    settings = compose_settings(["num_envs=40"])
    simulation, _ = build(settings)
    generator = torch.Generator().manual_seed(0)
    script = script(settings.task, settings.episode)
    bias = torch.randn(40, 3, generator=generator, dtype=torch.float64)
    bias *= 0.004 / bias.norm(dim=-1, keepdim=True)

    def learner(signals: Signals) -> Tensor:
        return _guessed(script, signals, bias, 0.0035, generator)

    outcome = run_episodes(simulation, learner)
    assert least <= outcome.facts["threaded"].double().mean() <= most


@pytest.mark.parametrize(
    ("jaw", "height", "rises"),
    [(1.3, 0.007, False), (0.5, 0.007, True), (0.8, 0.0, False), (0.1, 0.0, True)],
    ids=["open above", "half shut above", "shutting", "shut on nothing"],
)
def test_the_smooth_expert_rises_where_jaws_would_rest_on_the_needle(jaw, height, rises):
    settings = compose_settings()
    simulation, _ = build(settings)
    seen = simulation.reset().signals.clone()
    seen.tool_midpoint = seen.pickup_point.clone()
    seen.tool_midpoint[:, 2] += height
    seen.jaw = seen.jaw_command = torch.full_like(seen.jaw, jaw)
    up = smooth(settings.task, settings.episode)(seen)[:, 2]
    assert (up > 0.2).all() if rises else (up < -0.1).all()


def test_a_grasp_changes_little_before_the_needle_is_off_the_table():
    settings = compose_settings()
    simulation, _ = build(settings)
    script = smooth(settings.task, settings.episode)
    seen = simulation.reset().signals.clone()
    seen.tool_midpoint = seen.pickup_point.clone()
    seen.jaw = torch.full_like(seen.jaw, 0.37)
    without, held = seen.clone(), seen.clone()
    held.grasped = torch.ones_like(seen.grasped)
    assert (script(without) - script(held))[:, [0, 1, 2, 4]].abs().max() < 0.4
    assert (script(held)[:, 2] < 0.5).all()
    held.pickup_point[:, 2] += 0.01
    assert (script(held)[:, 2] == 1.0).all()


@pytest.mark.parametrize("script", [expert, smooth])
def test_expert_actions_are_within_bounds(script):
    settings = compose_settings()
    simulation, _ = build(settings)
    script = script(settings.task, settings.episode)
    moment = simulation.reset()
    for _ in range(60):
        action = script(moment.signals)
        assert action.shape == (8, 5)
        assert action.abs().max() <= 1.0
        moment = simulation.step(action)


def test_controllers_are_named():
    assert set(controllers(compose_settings())) == {"expert", "smooth", "cheat", "random"}
    with pytest.raises(ValueError, match=r"controller.*expert, smooth, cheat, random"):
        controller("expart", compose_settings())


@pytest.mark.parametrize("script", [expert, smooth])
def test_the_expert_refuses_another_control_mode(script):
    settings = compose_settings(["episode.control=pose"])
    with pytest.raises(ValueError, match=r"episode\.control"):
        script(settings.task, settings.episode)
