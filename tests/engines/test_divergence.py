"""A scene whose physics breaks down: its episode ends, and the others go on as before."""

from __future__ import annotations

import pytest
import torch
from tiny_runs import learner

from needlehoop.envs.build import build
from needlehoop.envs.controllers import outcome_of
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.simulation import Simulation


def built(kind: str) -> Simulation:
    words = ["num_envs=3", "episode.max_steps=6", "engine.threads=2", f"engine.kind={kind}"]
    return build(compose_settings(words))


def break_down(simulation: Simulation, env: int, value: float = float("nan")) -> None:
    broken = torch.tensor([value], dtype=torch.float64)
    simulation.engine.write("qvel", torch.tensor([env]), broken, 2)


@pytest.fixture(params=["cpu", "dm_control"])
def kind(request, elsewhere):
    yield request.param
    # MuJoCo writes its warnings to a file in the working directory, unless it is told not to.
    assert not [*elsewhere.iterdir()]


@pytest.mark.parametrize("value", [float("nan"), 1e12])
def test_an_episode_that_diverges_is_truncated_and_the_others_go_on(kind, value):
    whole, broken = built(kind), built(kind)
    actions = torch.rand(5, 3, 5, generator=torch.Generator().manual_seed(0)) * 2 - 1
    for simulation in (whole, broken):
        simulation.reset()
        simulation.step(actions[0])
    break_down(broken, 1, value)
    moment, other = broken.step(actions[1]), whole.step(actions[1])
    assert moment.facts["diverged"].tolist() == moment.truncated.tolist() == [False, True, False]
    assert not moment.terminated.any()
    assert moment.facts["diverged"].tolist() == [False, True, False]
    paid = (*moment.terms.values(), moment.potential, moment.reward)
    for tensor in (*moment.signals.values(), *paid):
        assert bool(torch.isfinite(tensor.double()).all())
    broken.reset(moment.truncated)
    rest = torch.tensor([0, 2])
    for action in actions[2:]:
        assert torch.equal(moment.potential[rest], other.potential[rest])
        moment, other = broken.step(action), whole.step(action)
        assert not moment.facts["diverged"].any()
    for name, tensor in broken.engine.snapshot().items():
        assert torch.equal(tensor[rest], whole.engine.snapshot()[name][rest]), name


def test_an_evaluation_counts_it(kind):
    simulation = built(kind)
    count = iter(range(10))

    def act(signals):
        if next(count) == 2:
            break_down(simulation, 0)
        return torch.zeros(3, 5)

    outcome = outcome_of(simulation, act)
    assert outcome.facts["diverged"].tolist() == [True, False, False]
    assert outcome.steps.tolist() == [3, 6, 6]
    assert outcome.summary()["diverged"] == pytest.approx(1 / 3)


def test_a_training_ends_where_the_physics_diverges_too_often(elsewhere):
    words = [
        *("cams=[]", "obs=signals", "num_envs=4", "episode.max_steps=4", "engine.threads=1"),
        *("algo.horizon=8", "algo.minibatch=16", "algo.epochs=1", "steps=320"),
    ]
    training = learner(*words)

    def go_on():
        for _ in training:
            break_down(training._collector.env.base_env.simulation, 0)

    with pytest.raises(FloatingPointError, match=r"the physics diverged in 2 of \d+ episodes"):
        go_on()
