"""What is true of a moment: grasped, lifted, touched, threaded. Facts are geometry."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.scene.signals import Signals
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
    grasped = _grasped(rules, memory, r, curve)
    near = geo.distance(r["pickup_point"], r["lift_position"]) < rules.lift_radius
    touched = geo.distance(r["needle_tip"], r["goal"]) < rules.goal_radius
    passed = passes_through(layout, rules.thread_depth, curve, r["goal"], r["hoop_axis"])
    weld = Weld(grasped != memory["grasped"], grasped, _relative_pose(r))
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


def _grasped(
    rules: NeedleRules, memory: Memory, readings: Mapping[str, Tensor], curve: Tensor
) -> Tensor:
    one, two, jaw = readings["jaw_1_touch"], readings["jaw_2_touch"], memory["jaw"]
    caught = one & two & (jaw < rules.close_below)
    held = memory["grasped"] & (jaw < rules.release_above)
    if rules.grasp == "friction":
        # Where nothing but contacts holds it, jaws closed on top of the needle hold nothing.
        if bool(caught.any()):
            caught = caught & _between_jaws(readings, curve)
        held = held & (one | two)
    return held | caught


def _between_jaws(readings: Mapping[str, Tensor], curve: Tensor) -> Tensor:
    """Whether the centre line runs through the gap between the blades; ``(n,)`` bool.

    Closed jaws resting on the needle touch it with both blades and hold nothing.
    """
    away = curve - readings["wrist_pos"].unsqueeze(1)
    x, y, z = geo.rotate(geo.conjugate(readings["tool_quat"]).unsqueeze(1), away).unbind(-1)
    half_gap = torch.sin(readings["jaw"] / 2).unsqueeze(-1) * psm.JAW_LENGTH
    inside = (x.abs() < psm.JAW_WIDTH / 2) & (y.abs() < half_gap) & (z < psm.JAW_LENGTH) & (z > 0)
    return inside.any(1)


def _relative_pose(readings: Mapping[str, Tensor]) -> Tensor:
    """The needle's pose in the wrist-yaw frame, ``(n, 7)``."""
    inverse = geo.conjugate(readings["wrist_quat"])
    position = geo.rotate(inverse, readings["pickup_point"] - readings["wrist_pos"])
    return torch.cat((position, geo.multiply(inverse, readings["needle_quat"])), -1)
