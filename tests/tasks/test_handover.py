"""The handover: what counts as handed, what only looks so, and whether the physics holds."""

from __future__ import annotations

import math
import re
from functools import cache
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor
from vlm_asked import RULES

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.tasks.handover import TASK, facts
from needlehoop.tasks.layout import GRASPS
from needlehoop.tasks.needle_hoop.needle import centre_line
from needlehoop.vlm.writing import reward_prompt


@cache
def handover(*words: str, layout: str = "standard") -> Settings:
    return compose_settings([f"task=handover/{layout}", "cams=[]", *words])


# What counts as handed, and what does not.


def decided(first: bool, second: bool, height: float, steps: int = 50, **memory: float) -> set[str]:
    """The facts of a moment: who holds a level needle at a height, m, and what was before."""
    s = handover()
    held = {"grasped_1": first, "grasped_2": second, "both": False, "released": False}
    past = {**held, "released_since": 0, "lifted_since": 0, "steps": steps, **memory}
    jaw, no = torch.zeros(1).double(), torch.zeros(1, dtype=torch.bool)
    values = {"jaw": jaw, "jaw_1_touch": no, "jaw_2_touch": no}
    values |= {"wrist_pos": torch.zeros(1, 3).double(), "tool_quat": torch.zeros(1, 4).double()}
    values["wrist_quat"] = torch.tensor([[1.0, 0, 0, 0]]).double()
    readings = {f"psm{arm}_{key}": value for arm in (1, 2) for key, value in values.items()}
    readings["needle_middle"] = torch.tensor([[0.0, 0.0, height]]).double()
    readings["needle_quat"] = torch.tensor([[1.0, 0, 0, 0]]).double()
    was = {name: torch.tensor([value]) for name, value in past.items()}
    was |= {"psm1_jaw": jaw, "psm2_jaw": jaw}
    outcome, welds = facts.observe(s.task, s.episode, was, readings)
    assert not (welds["psm1_grasp"].changed | welds["psm2_grasp"].changed).any()
    assert {name: tuple(value.shape) for name, value in outcome.items()} == {
        fact.name: (1,) for fact in TASK.facts
    }
    return {name for name, value in outcome.items() if bool(value)}


UP, LOW = 0.030, 0.008


@pytest.mark.parametrize(
    ("first", "second", "height", "memory", "true"),
    [
        (True, False, LOW, {}, {"grasped_1"}),
        (True, False, UP, {}, {"grasped_1", "lifted"}),
        (True, True, LOW, {}, {"grasped_1", "grasped_2"}),
        (True, True, UP, {}, {"grasped_1", "grasped_2", "lifted", "both"}),
        (False, True, UP, {"both": True}, {"grasped_2", "lifted", "released"}),
        # It sank, and was not let go of.
        (False, True, LOW, {"released": True}, {"grasped_2", "released"}),
        (False, True, UP, {}, {"grasped_2", "lifted", "fetched"}),
        (False, True, LOW, {}, {"grasped_2"}),
        (False, False, UP, {"both": True, "released": True}, set()),
    ],
)
def test_facts_say_who_holds_the_needle_and_how_it_came_there(first, second, height, memory, true):
    # Nothing has lasted long.
    recent = {"released_since": 49, "lifted_since": 49}
    assert decided(first, second, height, **recent, **memory) == true


@pytest.mark.parametrize(("released", "lifted"), [(40, 0), (0, 40), (40, 40), (41, 0), (0, 41)])
def test_handed_is_ten_steps_alone_and_lifted(released, lifted):
    since = {"released_since": released, "lifted_since": lifted}
    done = "handed" in decided(False, True, UP, released=True, **since)
    assert done == (max(released, lifted) <= 40)
    assert "handed" not in decided(False, True, LOW, released=True, **since)
    assert "handed" not in decided(False, True, UP, **since)
    assert "handed" not in decided(True, True, UP, both=True, **since)


def test_lifted_is_the_lowest_point_of_the_needle():
    s = handover()
    edge = s.episode.lift_height + s.task.needle_thickness / 2
    assert "lifted" in decided(True, False, edge + 1e-4)
    assert "lifted" not in decided(True, False, edge - 1e-4)


def flight(grasp: str = "weld", *words: str, envs: int = 3) -> SimpleNamespace:
    """A scene in which the expert flies, and the history of its facts."""
    settings = handover(f"num_envs={envs}", f"episode.grasp={grasp}", "seed=5", *words)
    simulation = build(settings)
    return SimpleNamespace(
        simulation=simulation, script=controller("expert", settings), moment=simulation.reset()
    )


def fly(scene, until: str, change=None, most: int = 120) -> list:
    """Step until a fact is true everywhere; ``change`` alters the expert's actions."""
    seen = []
    while not bool(scene.moment.facts[until].all()) and len(seen) < most:
        action = scene.script(scene.moment.signals)
        action = action if change is None else change(action)
        scene.moment = scene.simulation.step(action)
        seen.append(scene.moment.facts)
    return seen


def drops(action: Tensor) -> Tensor:
    """PSM 1 lets go, and stands still."""
    action[:, :4], action[:, 4] = 0.0, 1.0
    return action


@pytest.mark.parametrize("grasp", GRASPS)
def test_a_needle_that_was_dropped_and_picked_up_by_the_other_arm_is_not_handed(grasp):
    scene = flight(grasp, "episode.max_steps=300")
    fly(scene, "has_lifted")
    fly(scene, "handed", drops, most=15)
    assert not (scene.moment.facts["grasped_1"] | scene.moment.facts["lifted"]).any()
    simulation = scene.simulation
    fetch = TASK.controllers["cheat"](simulation.layout, simulation.episode)
    scene.script = lambda s: torch.cat((drops(fetch(s)[:, :5]), fetch(s)[:, 5:]), -1)
    seen = fly(scene, "has_fetched")
    seen += fly(scene, "handed", most=20)
    assert scene.moment.facts["has_fetched"].all()
    assert scene.moment.facts["cheat"].all()
    assert not any((step["handed"] | step["released"] | step["success"]).any() for step in seen)
    assert scene.moment.potential.max() < 2.5


# What pays.


def test_the_reward_rises_from_stage_to_stage():
    scene = flight()
    best = [scene.moment.potential.max()]
    for stage in ("grasped_1", "lifted", "both", "released", "handed"):
        fly(scene, stage)
        potential = scene.moment.potential
        assert potential.min() > best[-1] + 0.3, stage
        best.append(potential.max())
    assert best[-1] > 8.5


def test_the_second_arm_is_paid_for_waiting_with_open_jaws_where_it_takes_the_needle():
    scene = flight()
    s = scene.moment.signals
    before = scene.simulation.reward(s)
    # The needle has still to move by so much, less the slack.
    way = s.meeting - s.needle_middle
    place = s.pickup_2 + way * (1.0 - 0.01 / way.norm(dim=-1, keepdim=True))

    def waiting(height: float, jaw: float) -> Tensor:
        s.psm2_tool_midpoint = place + torch.tensor([0.0, 0.0, height]).double()
        s.psm2_jaw_command = torch.full((3,), jaw).double()
        terms = scene.simulation.reward(s)
        assert all(torch.equal(terms[key], before[key]) for key in before if key != "take")
        return terms["take"]

    ready = waiting(0.0, 1.35)
    assert (ready > before["take"] + 0.05).all()
    torch.testing.assert_close(ready, torch.full((3,), 1.5).double())
    for height, jaw in ((0.015, 1.35), (0.0, 0.0)):
        assert (waiting(height, jaw) < ready - 0.05).all()


def test_a_needle_near_the_meeting_place_is_as_good_as_there():
    scene = flight()
    fly(scene, "lifted")
    s = scene.moment.signals

    def lifted(away: float) -> list[float]:
        s.needle_middle = s.meeting + torch.tensor([0.6 * away, 0.0, -0.8 * away]).double()
        return scene.simulation.reward(s)["lift"].tolist()

    assert lifted(0.0) == lifted(0.0099) == [4.0] * 3
    assert lifted(0.02) == pytest.approx([4.0 * math.exp(-0.4)] * 3)


# The physics.


@pytest.mark.parametrize("grasp", GRASPS)
def test_arms_that_tear_at_the_needle_leave_the_physics_finite(grasp):
    scene = flight(grasp, "episode.end_on_success=false", envs=6)
    fly(scene, "has_both")
    generator = torch.Generator().manual_seed(1)
    engine, deepest = scene.simulation.engine, 0.0
    for step in range(80):
        if step % 10 == 0:
            pull = 2.0 * torch.rand(6, 10, generator=generator).double() - 1.0
            pull = pull.sign()
            # Half of them hold on to it.
            pull[:3, [4, 9]] = -1.0
        scene.moment = scene.simulation.step(pull)
        s = scene.moment.signals
        assert not scene.moment.facts["diverged"].any()
        assert engine.snapshot()["qvel"].isfinite().all()
        assert s.needle_middle.abs().max() < 0.3
        deepest = max(deepest, -float(engine.data(0).contact.dist.min(initial=0.0)))
    if grasp == "weld":
        assert (scene.moment.facts["grasped_1"] & scene.moment.facts["grasped_2"])[:3].all()
    assert deepest < 0.004


# Where episodes begin, and what is said of them.


@pytest.mark.parametrize("layout", ["near", "standard", "wide"])
def test_episodes_begin_with_the_needle_at_rest_in_reach_of_both(layout):
    s = handover("num_envs=100", "seed=3", layout=layout)
    simulation = build(s)
    moment = simulation.reset()
    assert not any(value.any() for value in moment.facts.values())
    place = moment.signals.needle_middle, moment.signals.needle_quat
    tail, tip = centre_line(s.task, *place)[:, [0, -1], 0].unbind(1)
    # The sharp end points to PSM 2, and each pickup point lies on its arm's side.
    assert (tail < tip).all()
    for name in ("pickup_1", "pickup_2"):
        arm = getattr(s.task, f"psm{name[-1]}")
        point = getattr(moment.signals, name)
        torch.testing.assert_close(arm.clamp(point)[:, :2], point[:, :2], rtol=0, atol=1e-9)
    for name in ("psm1", "psm2"):
        assert simulation.state is not None
        target = simulation.state[f"{name}_target"]
        tool = getattr(moment.signals, f"{name}_tool_midpoint")
        torch.testing.assert_close(tool, target, rtol=0, atol=1e-9)
    for _ in range(5):
        moment = simulation.step(torch.zeros(100, 10, dtype=torch.float64))
    torch.testing.assert_close(moment.signals.needle_middle, place[0], rtol=0, atol=1e-5)


def test_it_is_told_without_what_decides_success():
    s = handover()
    (prompt,) = reward_prompt(s, RULES)
    assert "$" not in prompt
    (posed,) = reward_prompt(handover("episode.control=pose"), RULES)
    assert "about each axis of its arm's base" in posed
    assert not re.search(r"\b(verdict|cheat|fetched|hold_steps|hoop)\b", prompt)
    assert TASK.cheating not in prompt
    (other,) = reward_prompt(handover("episode.hold_steps=17"), RULES)
    assert other == prompt
    (changed,) = reward_prompt(handover("episode.lift_height=0.0107"), RULES)
    assert "more than 10.7 mm above the table" in changed
