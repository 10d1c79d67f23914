"""The peg transfer: what counts as done, who can do it, and whether the physics holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from needle_task import row
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.envs.simulation import StepResult
from needlehoop.robot import geometry as geo
from needlehoop.tasks.layout import GRASPS
from needlehoop.tasks.peg_transfer.expert import Expert
from needlehoop.tasks.peg_transfer.facts import is_over, lower_edge
from needlehoop.tasks.peg_transfer.scene import place, start
from needlehoop.tasks.psm import start_of
from needlehoop.tasks.start import NUMBERS, Chance

LAYOUTS = ("near", "standard", "wide")
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
MARKED = 4


def peg_settings(*words: str, layout: str = "standard") -> Settings:
    return compose_settings([f"task=peg_transfer/{layout}", *words])


class Stage:
    """One scene in which the block is put somewhere by hand, the tool out of its way."""

    def __init__(self, *words: str):
        self.settings = peg_settings("num_envs=1", *words)
        self.layout = self.settings.task
        self.simulation = build(self.settings)
        self.simulation.reset()

    def put(self, x, y, z, quat=UPRIGHT, tool=(-0.03, -0.05, 0.05)) -> StepResult:
        """The block's middle relative to the goal, m; the jaws are open."""
        goal = (*self.layout.pegs[MARKED], self.layout.block_height / 2)
        block = torch.cat((row(*goal) + row(x, y, z), row(*quat)), -1)
        robot = start_of(self.layout, row(*tool), torch.zeros(1).double(), row(1.3)[0])
        begun = place(self.layout, robot, block, row(0.0, 0.0), torch.tensor([MARKED]))
        self.simulation.engine.reset(torch.tensor([0]), begun)
        assert self.simulation.state is not None
        for name in ("target", "joints", "jaw"):
            source = {"target": robot["tool"], "joints": robot["joints"], "jaw": robot["jaw"]}
            self.simulation.state[name] = source[name].clone()
        return self.simulation.look()

    def wait(self, steps: int, action: Tensor | None = None) -> StepResult:
        still = torch.zeros(1, 5, dtype=torch.float64) if action is None else action
        for _ in range(steps):
            moment = self.simulation.step(still)
        return moment


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Stage()


def tilted(angle: float) -> tuple[float, ...]:
    return (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)


# What counts as done, and what does not.


@pytest.mark.parametrize(
    ("yaw", "offset"), [(0.0, (0.0, 0.0)), (1.0, (0.002, 0.0)), (math.pi, (0.0, -0.002))]
)
def test_a_block_that_stands_over_the_marked_peg_is_placed(stage, yaw, offset):
    moment = stage.put(*offset, 0.0, (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))
    assert moment.facts["success"].all()
    assert not moment.facts["cheat"].any()
    assert stage.wait(5).facts["success"].all()


def test_a_block_dropped_over_the_marked_peg_is_placed_once_it_is_at_rest(stage):
    moment = stage.put(0.0, 0.0, 0.004)
    assert moment.facts["over"].all()
    assert not moment.facts["success"].any()
    assert stage.wait(10).facts["success"].all()


@pytest.mark.parametrize("direction", np.linspace(0, 2 * math.pi, 6, endpoint=False))
def test_a_block_dropped_beside_the_marked_peg_is_not_placed(stage, direction):
    out = 0.0145
    stage.put(out * math.cos(direction), out * math.sin(direction), 0.006)
    moment = stage.wait(25)
    assert not moment.facts["over"].any()
    assert not moment.facts["success"].any()
    assert moment.potential < 2.0


@pytest.mark.parametrize("peg", [0, 5])
def test_a_block_on_a_wrong_peg_is_not_placed(stage, peg):
    here, there = stage.layout.pegs[MARKED], stage.layout.pegs[peg]
    stage.put(there[0] - here[0], there[1] - here[1], 0.0)
    moment = stage.wait(5)
    assert not (moment.facts["success"] | moment.facts["over"] | moment.facts["arrived"]).any()


def test_taking_the_jaws_away_pays_once_the_block_is_let_go_and_less_than_placing_it(stage):
    near, far = (
        float(stage.put(0.0, 0.0, 0.002, tilted(0.15), tool=(0.02, -0.01, z)).potential)
        for z in (0.015, 0.05)
    )
    placed = float(stage.put(0.0, 0.0, 0.0).potential)
    assert near < far < placed - 1.0


@pytest.mark.parametrize("angle", [0.15, 0.4, 0.8])
def test_a_block_that_leans_on_the_peg_is_not_placed(stage, angle):
    assert not stage.put(0.0, 0.0, 0.002, tilted(angle)).facts["success"].any()


def test_a_block_that_still_moves_is_not_placed(stage):
    engine = stage.simulation.engine
    for column, speed in ((0, 0.05), (2, -0.05), (5, 2.0)):
        stage.put(0.0, 0.0, 0.0)
        state = engine.snapshot()
        joint = engine.model.joint("block")
        state["qvel"][0, int(joint.dofadr[0]) + column] = speed
        engine.restore(state)
        moment = stage.simulation.look()
        assert moment.facts["over"].all()
        assert not moment.facts["success"].any()


@pytest.mark.parametrize("grasp", GRASPS)
def test_a_block_pushed_along_the_board_does_not_get_over_the_peg(grasp):
    stage = Stage(f"episode.grasp={grasp}")
    stage.put(0.0135, 0.0, 0.0, tool=(stage.layout.pegs[MARKED][0] + 0.034, -0.016, 0.006))
    push = row(-1.0, 0.0, 0.0, 0.0, -1.0)
    for _ in range(60):
        moment = stage.wait(1, push)
        assert not (moment.facts["over"] | moment.facts["success"]).any()


# Geometry.


def test_the_lower_edge_is_the_lowest_corner():
    layout = peg_settings().task
    half = layout.block_height / 2
    corners = np.concatenate([np.c_[layout.corners, np.full(6, z)] for z in (-half, half)])
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        quat = torch.randn(1, 4, generator=generator, dtype=torch.float64)
        quat /= quat.norm()
        turned = geo.rotate(quat, torch.from_numpy(corners))
        low = lower_edge(layout, row(0.0, 0.0, 0.1), quat)
        assert float(low) == pytest.approx(0.1 + float(turned[:, 2].min()))


def test_over_is_the_whole_hole():
    layout = peg_settings().task
    upright, goal = row(*UPRIGHT), row(0.0, 0.0, 0.0)
    edge = layout.hole_radius
    assert is_over(layout, row(-edge + 1e-4, 0.0, 0.1), upright, goal)
    assert not is_over(layout, row(-edge - 1e-4, 0.0, 0.1), upright, goal)
    # Turned by half a turn, the wall is on the other side.
    assert is_over(layout, row(edge - 1e-4, 0.0, 0.1), row(0.0, 0.0, 0.0, 1.0), goal)
    assert not is_over(layout, row(0.0, 0.0, 0.1), row(*tilted(1.2)), goal)


# Where episodes begin.


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_block_begins_over_a_peg_that_is_not_the_marked_one(layout):
    settings = peg_settings("num_envs=200", "seed=3", layout=layout)
    simulation = build(settings)
    moment = simulation.reset()
    facts = moment.facts
    assert not (facts["success"] | facts["over"] | facts["arrived"] | facts["grasped"]).any()
    begun = start(settings.task, Chance(torch.rand(500, NUMBERS, dtype=torch.float64)))
    pegs = [begun.mocap[f"peg_{i}"] for i in range(5)]
    places = torch.stack([*pegs, begun.mocap["marked"]], 1)[..., :2]
    gaps = torch.cdist(places, places) + torch.eye(6)
    assert gaps.min() > 0.02
    nearest = torch.linalg.vector_norm(places - begun.free["block"][:, None, :2], dim=-1).argmin(-1)
    assert (nearest < 5).all()
    marked = begun.mocap["marked"][:, :2] - begun.mocap["board"][:, :2]
    marks = {tuple(round(v, 4) for v in place) for place in marked.tolist()}
    assert marks == {settings.task.pegs[i] for i in settings.task.goals}


# The physics.


@pytest.mark.parametrize("grasp", ["weld", pytest.param("friction", marks=pytest.mark.full)])
def test_hostile_actions_leave_the_physics_finite_and_the_block_outside_of_things(grasp):
    settings = peg_settings("num_envs=9", f"episode.grasp={grasp}", layout="wide")
    simulation = build(settings)
    script = Expert(settings.task, settings.episode)
    generator = torch.Generator().manual_seed(1)
    moment, deepest, ram = simulation.reset(), 0.0, torch.zeros(9, 5, dtype=torch.float64)
    for step in range(100):
        if step % 7 == 0:
            ram = 2.0 * torch.randint(0, 2, (9, 5), generator=generator).double() - 1.0
            ram[:, 4] = -1.0
        rams = (moment.signals.grasped & (torch.arange(9) % 3 > 0)).unsqueeze(-1)
        moment = simulation.step(torch.where(rams, ram, script(moment.signals)))
        assert torch.isfinite(moment.signals.block_position).all()
        assert (moment.signals.block_position[:, 2] > 0).all()
        if step % 10 == 0:
            for env in range(9):
                deepest = max(deepest, -simulation.engine.data(env).contact.dist.min(initial=0.0))
        over = moment.terminated | moment.truncated
        if bool(over.any()):
            moment = simulation.reset(over)
            assert not moment.facts["success"][over].any()
    assert deepest < 0.0014
