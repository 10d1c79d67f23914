"""What is true of a moment: near, stayed. Facts are geometry."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from needlehoop.robot.geometry import distance
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.reach.layout import ReachLayout, ReachRules

FACTS = (Fact("near", once=True, timed=True, column="has_near"), Fact("stayed"))


def observe(
    layout: ReachLayout, rules: ReachRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts, see ``contract.Task``."""
    near = distance(readings["tool_midpoint"], readings["target"]) < rules.near_radius
    lasted = memory["steps"] - memory["near_since"]
    return {"near": near, "stayed": near & (lasted >= rules.near_steps)}, {}
