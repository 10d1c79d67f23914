from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from needle_task import load_reward, start

from needlehoop import rewards
from needlehoop.config import composing
from needlehoop.robot import psm
from needlehoop.runs.files import reward_name
from needlehoop.scene.signals import Signals
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.tasks.needle_hoop.reward import Human
from needlehoop.tasks.start import draws

TABLE = TASK.signals


@pytest.fixture(scope="module")
def values() -> dict[str, dict]:
    """The values of each reward's YAML."""
    return {kind: composing.compose([f"reward={kind}"])["reward"] for kind in ("human", "sparse")}


@pytest.fixture(scope="module")
def human(values) -> Human:
    reward = load_reward(values["human"])
    assert isinstance(reward, Human)
    return reward


def signals_of(**values) -> Signals:
    """Signals of one environment: all points at the origin, all facts false, but for ``values``."""
    fields = {}
    for name, signal in TABLE.items():
        kind = torch.bool if signal.unit == "bool" else torch.float64
        fields[name] = torch.zeros(1, *signal.shape, dtype=kind)
        if name in values:
            fields[name][0] = torch.as_tensor(values[name], dtype=kind)
    return TASK.signals_class(**fields, batch_size=[1])


PERFECT = {"grasped": True, "lifted": True, "touched": True, "threaded": True, "elapsed": 0.25}
FAR = (0.3, 0.0, 0.0)


def terms_of(reward, **values) -> dict[str, float]:
    return {name: float(term) for name, term in reward(signals_of(**values)).items()}


def total(reward, **values) -> float:
    return float(rewards.potential(reward(signals_of(**values))))


def test_a_perfect_state_is_worth_the_papers_nine_and_our_terms_less_the_time(human):
    paper = replace(human, surround=0.0, pinch=0.0)
    assert total(paper, **PERFECT) == pytest.approx(9.0 - human.time * 0.25)
    ours = human.surround + human.pinch
    assert total(human, **PERFECT) == pytest.approx(9.0 + ours - human.time * 0.25)
    assert human.time > 0


def jaws(angle: float, along: float, aside: float = 0.0) -> dict:
    """Jaws so far open, rad, with the pickup point so far from their hinge and aside of it, m."""
    place = {"tool_quat": (1.0, 0.0, 0.0, 0.0), "pickup_point": (0.0, aside, along)}
    return {**place, "jaw": angle, "jaw_command": angle}


def test_open_jaws_are_paid_for_coming_down_about_the_needle_and_shut_ones_less(human):
    paid = [terms_of(human, **jaws(1.3, along))["surround"] for along in (0.03, 0.015, 0.012, 0.01)]
    assert paid == sorted(paid)
    assert paid[-1] == human.surround
    on_top = terms_of(human, **jaws(0.0, psm.JAW_LENGTH + 0.0019))
    assert 0 < on_top["surround"] < human.surround
    assert on_top["pinch"] == 0


def test_shutting_the_jaws_is_paid_where_something_is_between_them(human):
    paid = [terms_of(human, **jaws(angle, 0.008))["pinch"] for angle in (1.3, 0.8, 0.4)]
    assert paid == sorted(paid)
    assert 0 < paid[0] < paid[-1] < human.pinch
    assert terms_of(human, **jaws(0.4, 0.008, aside=0.004))["pinch"] == 0
    held = terms_of(human, **jaws(0.4, 0.008), grasped=True)
    assert (held["surround"], held["pinch"]) == (human.surround, human.pinch)


def test_the_start_is_worth_little_more_than_the_time_that_waiting_costs(human, layout):
    drawn = np.stack([draws(0, env, 0) for env in range(500)])
    begun = start(layout, torch.from_numpy(drawn))
    worth = [
        total(
            human,
            tool_midpoint=begun.robot["tool"][i],
            pickup_point=begun.free["needle"][i, :3],
            lift_position=begun.mocap["lift_position"][i],
            needle_tip=begun.free["needle"][i, :3],
            goal=begun.mocap["hoop"][i],
            jaw_command=begun.robot["jaw"][i],
        )
        for i in range(len(begun))
    ]
    assert min(worth) > 0
    assert max(worth) - human.time < 0.5


DISTANCES = {
    "grasp": ("tool_midpoint", {}),
    "lift": ("lift_position", {"grasped": True}),
    "hoop": ("goal", {"lifted": True}),
}


@pytest.mark.parametrize("term", DISTANCES)
def test_nearer_is_worth_more_until_the_tolerance(human, term):
    moved, facts = DISTANCES[term]
    away = np.linspace(0.0, 0.1, 41)
    worth = [terms_of(human, **{moved: (0.0, d, 0.0)}, **facts)[term] for d in away]
    within = away <= human.tolerance * human.unit
    assert 1 < within.sum() < len(away)
    full = getattr(human, term)
    assert [worth[i] for i in range(len(away)) if within[i]] == [full] * int(within.sum())
    outside = np.array(worth)[~within]
    assert (np.diff(outside) < 0).all()
    assert 0 < outside.min() <= outside.max() < full
    half = (human.tolerance + math.log(2) / human.rate) * human.unit
    assert terms_of(human, **{moved: (half, 0, 0)}, **facts)[term] == pytest.approx(
        getattr(human, term) / 2
    )


def test_a_larger_scene_unit_makes_every_length_larger(human, values):
    larger = load_reward({**values["human"], "unit": 2 * human.unit})
    for away in (0.001, 0.004, 0.03):
        near, far = ({"tool_midpoint": (x, 0, 0)} for x in (away, 2 * away))
        assert terms_of(larger, **far)["grasp"] == pytest.approx(terms_of(human, **near)["grasp"])


def test_what_is_grasped_or_lifted_is_paid_in_full_at_any_distance(human):
    far = {"tool_midpoint": FAR, "lift_position": FAR}
    assert terms_of(human, **far)["grasp"] < 0.01
    assert terms_of(human, grasped=True, **far)["grasp"] == human.grasp
    assert terms_of(human, **far)["lift"] < 0.01
    assert terms_of(human, lifted=True, **far)["lift"] == human.lift


def test_the_hoop_pays_nothing_before_the_lift(human):
    for tip in ((0.0, 0.0, 0.0), (0.1, -0.05, 0.02)):
        assert terms_of(human, needle_tip=tip, grasped=True)["hoop"] == 0.0
        assert terms_of(human, needle_tip=tip, grasped=True, lifted=True)["hoop"] > 0.0


def test_the_closed_bonus_needs_a_grasp_and_a_closed_command(human):
    for grasped, share, paid in ((True, 0.99, human.closed), (True, 1.0, 0), (False, 0.0, 0)):
        command = share * human.closed_below
        assert terms_of(human, grasped=grasped, jaw_command=command)["closed"] == paid


def test_the_human_reward_does_not_see_the_verdict(human):
    failed = {**PERFECT, "touched": False, "threaded": False}
    assert terms_of(human, **PERFECT) == terms_of(human, **failed)


def test_the_sparse_reward_pays_success_alone():
    sparse = load_reward({"kind": "sparse", "success": 5.0})
    almost = {**PERFECT, "threaded": False}
    assert terms_of(sparse, **almost) == {"success": 0.0}
    assert terms_of(sparse, **PERFECT) == {"success": 5.0}


def test_a_value_that_is_no_good_is_refused_by_name(values):
    human = values["human"]
    for config, message in (
        ({**human, "kind": "humane"}, r"reward\.kind: .*human, sparse"),
        ({**values["sparse"], "bonus": 1.0}, "reward: unknown key bonus; its keys are success"),
        ({**human, "grasp": "two"}, r"reward\.grasp: .*not a number"),
        ({**human, "name": "sparse"}, "'sparse' means another reward; choose a name of your own"),
        ({**human, "name": "a/b"}, r"reward\.name: 'a/b' is no name for a folder"),
    ):
        with pytest.raises(ValueError, match=message):
            load_reward(config)


def test_a_name_changes_what_a_reward_is_called_and_nothing_else(values):
    named = {**values["human"], "name": "my idea-2"}
    assert load_reward(named) == load_reward(values["human"])
    assert rewards.with_source(named) == named
    assert [reward_name(config) for config in (named, values["human"])] == ["my idea-2", "human"]
