"""A grasp is a grasp: something between the blades, and nothing else, in the physics itself."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from needle_task import row
from strength import ALL
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.simulation import StepResult
from needlehoop.robot import geometry as geo
from needlehoop.tasks.layout import GRASPS
from needlehoop.tasks.needle_hoop import scene as needle_scene
from needlehoop.tasks.peg_transfer import scene as peg_scene
from needlehoop.tasks.psm import start_of
from needlehoop.tasks.start import Start, standing
from needlehoop.tasks.stepping import begin

PLACE = (0.0, -0.02)
"""Where the pickup point is, x and y, m."""
CLEAR = 0.02
"""How far above its place the tool begins, m: free of needle and block."""


class Bench:
    """Copies of one thing on the table, and jaws that come down at it, close, and rise.

    A case is where the tool goes, ``(x, y, z)`` from the pickup point in mm, and how far it is
    turned about the instrument, in degrees from where the blades open across the thing.
    """

    def __init__(self, task: str, grasp: str, cases: list[tuple[tuple, float]], jaw: float = 1.3):
        words = [f"task={task}", f"episode.grasp={grasp}", "episode.end_on_success=false"]
        settings = compose_settings([*words, "episode.max_steps=2000", f"num_envs={len(cases)}"])
        # The tool may go anywhere, and turn all the way round.
        layout = replace(settings.task, workspace_lower=(-0.1, -0.1, 0.0), roll_range=7.0)
        self.simulation = build(replace(settings, task=layout))
        point, thing = AT_REST[settings.definition.holds](layout)
        offsets = torch.tensor([offset for offset, _ in cases], dtype=torch.float64) / 1000
        turns = torch.tensor([turn for _, turn in cases], dtype=torch.float64)
        self.target = point + offsets
        begins = self.target + torch.tensor([0.0, 0.0, CLEAR])
        robot = start_of(layout, begins, turns.deg2rad(), torch.full_like(turns, jaw))
        begun = BEGUN[settings.definition.holds](layout, robot, thing.expand(len(cases), 7))
        self.simulation.reset()
        self.simulation.state = begin(settings.definition, settings.episode, begun)
        self.simulation.engine.reset(torch.arange(len(cases)), begun)

    def close(self) -> StepResult:
        """Down, and the jaws shut as far as they will go."""
        self.go(self.target, 0.0, 6)
        return self.go(self.target, -1.0, 8)

    def rise(self) -> StepResult:
        """By 30 mm, the jaws told to be shut."""
        return self.go(self.target + torch.tensor([0.0, 0.0, 0.03]), -1.0, 12)

    def go(self, target: Tensor, jaw: float, steps: int) -> StepResult:
        """To places ``(n, 3)``, m, with the action ``jaw`` of the jaws."""
        simulation = self.simulation
        for _ in range(steps):
            assert simulation.state is not None
            away = (target - simulation.state["target"]) / simulation.episode.translation
            still = torch.zeros(len(target), 1, dtype=torch.float64)
            moment = simulation.step(torch.cat((away.clamp(-1.0, 1.0), still, still + jaw), -1))
        return moment


def needle_at_rest(layout) -> tuple[Tensor, Tensor]:
    """The pickup point ``(1, 3)`` and the pose ``(1, 7)`` of the needle."""
    height = layout.needle_thickness / 2
    return row(*PLACE, height), standing(row(*PLACE), height - 1.25e-6, torch.zeros(1))


def block_at_rest(layout) -> tuple[Tensor, Tensor]:
    """The same of the block, whose first wall is grasped."""
    x, y = PLACE
    middle = row(x - layout.hole_radius - layout.wall / 2, y)
    block = standing(middle, layout.block_height / 2 - 2.82e-7, torch.zeros(1))
    return row(*PLACE, layout.block_height - layout.pickup_depth), block


def begun_with_needle(layout, robot, needle: Tensor) -> Start:
    return needle_scene.place(robot, needle, row(0.02, 0.03, 0.036).expand(len(needle), 3))


def begun_with_block(layout, robot, block: Tensor) -> Start:
    """All pegs out of the way."""
    away, marked = row(0.0, 0.08).expand(len(block), 2), torch.full((len(block),), 5)
    return peg_scene.place(layout, robot, block, away, marked)


AT_REST = {"needle": needle_at_rest, "block": block_at_rest}
BEGUN = {"needle": begun_with_needle, "block": begun_with_block}


NEEDLE = {
    "low": ((0, 0, -1), 0, True),
    "at the pickup point": ((0, 0, 0), 0, True),
    "high": ((0, 0, 1), 0, True),
    "at the blades' ends": ((0, 0, 2.5), 0, False),
    "above it": ((0, 0, 3.8), 0, False),
    **{f"turned by {t}": ((0, 0, 0.5), t, True) for t in (15, 30, 150, 165)},
    **{f"turned by {t}, so crosswise": ((0, 0, 0.5), t, False) for t in (67.5, 90, 112.5)},
    "beside it": ((6, 0, 0.5), 0, False),
    "beside it, one blade on top": ((-4, 0, 0.5), 0, False),
    "along it": ((0, 6, 0.5), 0, True),
}

BLOCK = {
    "low": ((0, 0, -1), 0, True),
    "at the pickup point": ((0, 0, 0), 0, True),
    "high": ((0, 0, 3), 0, True),
    "above it": ((0, 0, 6.5), 0, False),
    "turned by 15": ((0, 0, 0), 15, True),
    "crosswise": ((0, 0, 2), 90, False),
    "outside the wall": ((8, 0, 0), 0, False),
    "along it": ((0, 4, 0), 0, True),
}


@pytest.mark.parametrize("grasp", GRASPS)
@pytest.mark.parametrize(("task", "cases"), [("standard", NEEDLE), ("peg_transfer", BLOCK)])
def test_jaws_hold_what_is_between_them_and_nothing_else(task, cases, grasp):
    """Weld and friction say the same, and what is held comes along."""
    bench = Bench(task, grasp, [(offset, turn) for offset, turn, _ in cases.values()])
    expected = {name: held for name, (_, _, held) in cases.items()}
    moment = bench.close()
    before = moment.signals.pickup_point[:, 2].clone()
    assert dict(zip(cases, moment.facts["grasped"].tolist(), strict=True)) == expected
    risen = bench.rise().signals.pickup_point[:, 2] > before + 0.015
    assert dict(zip(cases, risen.tolist(), strict=True)) == expected


@pytest.mark.parametrize("grasp", GRASPS)
@pytest.mark.parametrize(
    ("task", "heights"), [("standard", (0, 1, 2, 3)), ("peg_transfer", (0, 3, 5))]
)
def test_shut_jaws_pressed_on_a_thing_hold_nothing(task, heights, grasp):
    cases = [((0, 0, z), turn) for z in heights for turn in (0, 22.5, 45, 67.5, 90, 112.5, 135)]
    bench = Bench(task, grasp, cases, jaw=0.0)
    moment = bench.close()
    before = moment.signals.pickup_point[:, 2].clone()
    assert (moment.signals.jaw_1_touch & moment.signals.jaw_2_touch).any()
    moment = bench.rise()
    assert not moment.facts["has_grasped"].any()
    assert (moment.signals.pickup_point[:, 2] < before + 0.005).all()


@pytest.mark.parametrize("task", ["standard", "peg_transfer"])
def test_what_is_held_by_friction_stays_where_it_is(task):
    bench = Bench(task, "friction", [((0, 0, 0), 0), ((0, 0, -1), 10)])
    bench.close()
    start, seconds = in_tool(bench.rise()), 60 if ALL else 12
    steps = round(seconds / bench.simulation.settings.period)
    moment = bench.go(bench.simulation.state["target"], 0.0, steps)
    assert moment.facts["grasped"].all()
    assert (in_tool(moment) - start).norm(dim=-1).max() < 0.0005


def in_tool(moment: StepResult) -> Tensor:
    """The pickup point in the tool frame ``(n, 3)``, m."""
    s = moment.signals
    return geo.rotate(geo.conjugate(s.tool_quat), s.pickup_point - s.tool_midpoint)
