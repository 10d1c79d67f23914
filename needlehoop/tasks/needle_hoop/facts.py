"""What is true of a moment: grasped, lifted, touched, threaded. Facts are geometry."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.needle_hoop.needle import centre_line
from needlehoop.tasks.needle_hoop.scene import NeedleLayout, NeedleRules
from needlehoop.tasks.psm import hold

FACTS = (
    Fact("grasped", "the needle is held", remembered=True, once=True),
    Fact("lifted", "the held needle has reached the lift position; stays true", remembered=True),
    Fact("touched", "the tip is within the goal's radius", verdict=True, once=True),
    Fact("threaded", "the held needle passes through the opening", verdict=True),
)


def observe(
    layout: NeedleLayout, rules: NeedleRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts, see ``contract.Task``."""
    r = readings
    place = r["pickup_point"], r["needle_quat"]
    curve = centre_line(layout, *place)
    grasped, welds = hold(rules, memory, r, curve, *place)
    near = geo.distance(r["pickup_point"], r["lift_position"]) < rules.lift_radius
    touched = geo.distance(r["needle_tip"], r["goal"]) < rules.goal_radius
    passed = passes_through(layout, rules.thread_depth, curve, r["goal"], r["hoop_axis"])
    facts = {
        "grasped": grasped,
        "lifted": memory["lifted"] | (grasped & near),
        "touched": touched,
        "threaded": passed & grasped,
    }
    return facts, welds


def passes_through(
    layout: NeedleLayout, depth: float, curve: Tensor, goal: Tensor, axis: Tensor
) -> Tensor:
    """Whether needles pass through the opening, tip first; ``(n,)`` bool.

    The stretch between tip and pickup point must cross the hoop's plane, the crossing
    nearest the tip must lie inside the opening, and the tip must be ``depth`` beyond
    the plane. Either direction counts: the opening has no front.

    Args:
        layout: radius of the opening.
        depth: m.
        curve: centre lines ``(n, k, 3)`` from tail to tip, world frame, m.
        goal: centre of the opening ``(n, 3)``.
        axis: unit vector through it ``(n, 3)``.
    """
    tail, tip = layout.needle_angles
    pickup = round(-tail / (tip - tail) * (curve.shape[1] - 1))
    leading = curve[:, pickup:].flip(1)
    offset = leading - goal.unsqueeze(1)
    height = geo.dot(offset, axis.unsqueeze(1))
    radial = offset - height.unsqueeze(-1) * axis.unsqueeze(1)
    here, there = height[:, :-1], height[:, 1:]
    crosses = (here > 0) != (there > 0)
    # Where the segment meets the plane; segments that do not cross are masked below.
    share = (here / torch.where(crosses, here - there, torch.ones_like(here))).unsqueeze(-1)
    meets = radial[:, :-1] + share * (radial[:, 1:] - radial[:, :-1])
    inside = geo.dot(meets, meets) < layout.hoop_opening**2
    first = crosses & (crosses.cumsum(1) == 1)
    return (first & inside).any(1) & (height[:, 0].abs() >= depth)
