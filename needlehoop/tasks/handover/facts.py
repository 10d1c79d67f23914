"""What is true of a moment: who holds the needle, and how it came there. Facts are geometry."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from needlehoop.tasks.arms import by_arm, of_arm
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.handover.scene import HandoverLayout, HandoverRules
from needlehoop.tasks.needle_hoop.needle import centre_line
from needlehoop.tasks.psm import hold

FACTS = (
    Fact("grasped_1", "PSM 1 holds the needle", remembered=True, once=True),
    Fact(
        "lifted", "the needle is held, and all of it is well above the table", once=True, timed=True
    ),
    Fact("grasped_2", "PSM 2 holds the needle", remembered=True, once=True),
    Fact("both", "both arms hold the lifted needle", remembered=True, once=True),
    Fact(
        "fetched",
        "PSM 2 alone holds the lifted needle, and has not taken it from PSM 1",
        verdict=True,
        once=True,
    ),
    Fact(
        "released",
        "PSM 2 alone holds the needle, since PSM 1 let go while both held it, lifted",
        remembered=True,
        once=True,
        timed=True,
    ),
    Fact("handed", "it has been so, and lifted, for as long as the task asks for", verdict=True),
)


def observe(
    layout: HandoverLayout, rules: HandoverRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts, see ``contract.Task``."""
    place = readings["needle_middle"], readings["needle_quat"]
    curve = centre_line(layout, *place)
    held, welds = [], {}
    for name, before in (("psm1", "grasped_1"), ("psm2", "grasped_2")):
        arm_memory = {**of_arm(name, memory), "grasped": memory[before]}
        now, welds[name] = hold(rules, arm_memory, of_arm(name, readings), curve, *place)
        held.append(now)
    first, second = held
    lowest = curve[..., 2].amin(1) - layout.needle_thickness / 2
    lifted = (first | second) & (lowest > rules.lift_height)
    alone = second & ~first
    released = alone & (memory["both"] | memory["released"])
    since = torch.maximum(memory["released_since"], memory["lifted_since"])
    kept = memory["steps"] - since >= rules.hold_steps
    facts = {
        "grasped_1": first,
        "lifted": lifted,
        "grasped_2": second,
        "both": first & second & lifted,
        "fetched": alone & ~released & lifted,
        "released": released,
        "handed": released & lifted & kept,
    }
    return facts, by_arm(welds)
