"""What is true of a moment: grasped, lifted, touched, threaded. Facts are geometry."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.signals import Signals
from needlehoop.tasks import psm_grasp
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.needle_hoop.crossing import centre_line, passes_through
from needlehoop.tasks.needle_hoop.layout import NeedleLayout
from needlehoop.tasks.needle_hoop.rules import NeedleRules
from needlehoop.tasks.needle_hoop.scene import WELD

FACTS = (
    Fact("grasped", remembered=True, once=True, column="has_grasped"),
    Fact("lifted", remembered=True),
    Fact("touched", once=True, column="has_touched"),
    Fact("threaded"),
)


def observe(
    layout: NeedleLayout, rules: NeedleRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts from the scene's readings.

    Args:
        layout: sizes of needle and hoop.
        rules: thresholds.
        memory: after the action.
        readings: named sensor readings, current (read after a forward).

    Returns:
        The facts ``(n,)`` by name, and what the grasp's weld has to become.
    """
    r = readings
    curve = centre_line(layout, r["pickup_point"], r["needle_quat"])
    grasped = psm_grasp.grasped(rules, memory, r, lambda: curve)
    near = geo.distance(r["pickup_point"], r["lift_position"]) < rules.lift_radius
    touched = geo.distance(r["needle_tip"], r["goal"]) < rules.goal_radius
    passed = passes_through(layout, rules.thread_depth, curve, r["goal"], r["hoop_axis"])
    weld = psm_grasp.weld(memory, r, grasped, r["pickup_point"], r["needle_quat"])
    facts = {
        "grasped": grasped,
        "lifted": memory["lifted"] | (grasped & near),
        "touched": touched,
        "threaded": passed & grasped,
    }
    return facts, {WELD: weld} if rules.grasp == "weld" else {}


def success(rules: NeedleRules, signals: Signals) -> Tensor:
    """Whether the task is done, as ``episode.success`` has it; ``(n,)`` bool."""
    return signals.touched if rules.success == "touch" else signals.threaded


def cheat(memory: Memory, signals: Signals) -> Tensor:
    """The tip has touched the goal in this episode, and the needle is not through; ``(n,)``."""
    return memory["has_touched"] & ~signals.threaded
