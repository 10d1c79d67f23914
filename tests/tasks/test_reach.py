"""Reach: what counts as done, what pays, who can do it, and that its physics holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.envs.simulation import Simulation
from needlehoop.rewards import potential
from needlehoop.tasks import stepping
from needlehoop.tasks.reach import TASK
from needlehoop.tasks.reach.expert import Expert, Smooth
from needlehoop.tasks.reach.scene import BUMPS, start
from needlehoop.tasks.start import NUMBERS, Chance, draws

VARIANTS = ("near", "standard", "wide")
TARGET = torch.tensor([[0.004, -0.02, 0.02]], dtype=torch.float64)


def settings_of(*words: str, variant: str = "standard") -> Settings:
    return compose_settings([f"task=reach/{variant}", *words])


def simulation_of(*words: str, variant: str = "standard") -> Simulation:
    return build(settings_of(*words, variant=variant))


def places(*offsets: tuple[float, float, float]) -> list[Tensor]:
    """Places of the tool, mm from the target."""
    return [TARGET + torch.tensor([one], dtype=torch.float64) / 1000 for one in offsets]


def stayed(path: list[Tensor]) -> list[bool]:
    """Whether an episode is successful after each of the tool's places."""
    settings = settings_of()
    at = (TASK, settings.task, settings.episode)
    begun = start(settings.task, Chance(torch.full((1, NUMBERS), 0.5, dtype=torch.float64)))
    memory, successes = stepping.begin(TASK, settings.episode, begun), []
    still = {"target": TARGET, "tool_quat": torch.zeros(1, 4), "wrist_quat": torch.zeros(1, 4)}
    still |= {"wrist_pos": TARGET, "joints": torch.zeros(1, 6), "jaw": torch.zeros(1)}
    for tool in path:
        memory, _ = stepping.act(*at, memory, torch.zeros(1, 5))
        # Looking again is no step.
        for _ in range(2):
            memory, _, facts, _ = stepping.observe(*at, memory, {**still, "tool_midpoint": tool})
        successes.append(bool(facts["success"]))
    return successes


IN, OUT = (1.0, 1.0, -1.0), (0.0, 0.0, 20.0)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        pytest.param([OUT, IN, IN, IN, IN], [0, 0, 0, 1, 1], id="comes and stays"),
        pytest.param([IN, IN, OUT, IN, IN, OUT], [0] * 6, id="comes twice for two steps"),
        pytest.param([IN, IN, IN, OUT], [0, 0, 1, 0], id="stays and leaves"),
        pytest.param([(0, 0, 3.5)] * 5, [0] * 5, id="hovers above"),
        pytest.param([(2.2, -2.2, 0)] * 5, [0] * 5, id="beside"),
        pytest.param([(0, 0, 2.9)] * 3, [0, 0, 1], id="just within"),
        pytest.param([(2.9, 0, 0), (0, -2.9, 0), (0, 0, -2.9)], [0, 0, 1], id="moves about within"),
    ],
)
def test_success_is_to_be_there_for_three_steps(path, expected):
    assert stayed(places(*path)) == [bool(one) for one in expected]


def test_the_right_height_over_another_mark_is_not_the_target():
    simulation = simulation_of("num_envs=32")
    layout, chosen = simulation.layout, []
    simulation.begin()
    above = np.array([0.0, 0.0, layout.target_above_bump])
    for env in range(32):
        data = simulation.engine.data(env)
        points = np.stack([data.body(f"mark_{i}").xpos for i in range(BUMPS)]) + above
        away = np.linalg.norm(points - data.body("target").xpos, axis=1)
        chosen.append(int(away.argmin()))
        assert away.min() < 1e-12
        # Whoever is at another one is far from being near.
        assert (np.sort(away)[1:] > 3 * simulation.episode.near_radius).all()
    assert set(chosen) == set(range(BUMPS))


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_episode_begins_near_or_in_contact(variant):
    simulation = simulation_of("num_envs=200", variant=variant)
    for _ in range(3):
        moment = simulation.reset()
        away = (moment.signals.tool_midpoint - moment.signals.target).norm(dim=-1)
        assert away.min() > 2 * simulation.episode.near_radius
        assert not moment.facts["near"].any()
        assert not any(simulation.engine.data(env).ncon for env in range(0, 200, 10))


@pytest.mark.parametrize("variant", VARIANTS)
def test_bumps_and_target_stand_where_the_tool_can_be_and_cameras_look(variant):
    layout = settings_of(variant=variant).task
    ends = torch.tensor([0.0, 1.0 - 1e-9], dtype=torch.float64)
    corners = ends.unsqueeze(-1).expand(2, NUMBERS)
    drawn = [torch.from_numpy(draws(3, env, 0)) for env in range(200)]
    begun = start(layout, Chance(torch.cat((corners, torch.stack(drawn)))))
    for place in (begun.mocap["target"], begun.robot["tool"]):
        assert (place >= torch.tensor(layout.workspace_lower)).all()
        assert (place <= torch.tensor(layout.workspace_upper)).all()
    tops = torch.stack([begun.mocap[f"bump_{i}"] for i in range(BUMPS)], 1)
    assert (tops[..., 2] > 0).all()
    rows, columns = torch.triu_indices(BUMPS, BUMPS, 1)
    gaps = (tops[:, rows] - tops[:, columns])[..., :2].norm(dim=-1)
    assert gaps.min() > 2 * layout.target_radius


# What pays.


@pytest.mark.parametrize("kind", [Expert, Smooth, "random"])
def test_success_ends_with_the_highest_potential(kind):
    simulation = simulation_of("num_envs=40", "seed=11")
    setup = (simulation.layout, simulation.episode)
    if kind == "random":
        act = controller("random", replace(simulation.settings, seed=0))
    else:
        act = kind(*setup)
    moment, done = simulation.reset(), torch.zeros(40, dtype=torch.bool)
    paid = torch.zeros(40, dtype=torch.float64)
    for _ in range(simulation.episode.max_steps):
        moment = simulation.step(act(moment.signals))
        paid += moment.reward
        torch.testing.assert_close(paid, potential(moment.terms))
        done |= moment.facts["success"]
        assert (moment.potential[moment.facts["success"]] > 7.9).all()
        assert (moment.potential[~moment.facts["success"]] <= 5.0).all()
    assert bool(done.all()) == (kind != "random")
