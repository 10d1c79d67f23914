"""What is true of a moment: grasped, lifted, touched, threaded. Facts are geometry."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.grasping import hold
from needlehoop.tasks.needle_hoop.crossing import centre_line, passes_through
from needlehoop.tasks.needle_hoop.layout import NeedleLayout, NeedleRules

FACTS = (
    Fact("grasped", remembered=True, once=True, column="has_grasped"),
    Fact("lifted", remembered=True),
    Fact("touched", once=True, column="has_touched"),
    Fact("threaded"),
)


def observe(
    layout: NeedleLayout, rules: NeedleRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts, see ``contract.Task``."""
    r = readings
    place = r["pickup_point"], r["needle_quat"]
    curve = centre_line(layout, *place)
    grasped, welds = hold(rules, memory, r, lambda: curve, *place)
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


def success(rules: NeedleRules, signals: Signals) -> Tensor:
    """Whether the task is done, as ``episode.success`` has it; ``(n,)`` bool."""
    return signals.touched if rules.success == "touch" else signals.threaded


def cheat(memory: Memory, signals: Signals) -> Tensor:
    """The tip has touched the goal in this episode, and the needle is not through; ``(n,)``."""
    return memory["has_touched"] & ~signals.threaded
