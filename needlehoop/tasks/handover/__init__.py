"""Handover: one arm picks a suture needle off a table and hands it to the other.

``scene`` says what there is and where an episode begins, ``facts`` what is true, ``expert`` who
can do it, ``reward`` what a person would pay. ``docs/handover.md`` says where the arms stand.
"""

import math
from pathlib import Path

from needlehoop.tasks.arms import side_by_side
from needlehoop.tasks.contract import FlatClass, Phase, Task, Telling
from needlehoop.tasks.handover import expert, facts, reward, scene
from needlehoop.tasks.handover.scene import HandoverLayout, HandoverRules
from needlehoop.tasks.layout import lengths, millimetres
from needlehoop.tasks.psm import arm_values, grasped


def values(layout: HandoverLayout, rules: HandoverRules) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    arm = arm_values(layout.psm1, rules)
    return {
        **arm,
        **lengths(layout),
        "control": f"does this with each of the two arms: {arm['control']}",
        "lean": round(math.degrees(abs(layout.psm1.tilt))),
        "needle_arc": round(math.degrees(layout.needle_arc)),
        "tool_height": round(1000 * layout.psm1.tool_position[2]),
        "meeting_height": round(1000 * layout.meeting[2]),
        "grasped_1": grasped(rules, "the needle", "psm1_jaw_command"),
        "grasped_2": grasped(rules, "the needle", "psm2_jaw_command"),
        "lift_height": millimetres(rules.lift_height),
    }


TASK = Task(
    name="handover",
    summary="Pick a suture needle off a table with one arm and hand it to the other.",
    robot=side_by_side(scene.ARMS),
    layout=HandoverLayout,
    rules=HandoverRules,
    materials=scene.MATERIALS,
    build=scene.build,
    things=scene.THINGS,
    holds="needle",
    classes={"needle": FlatClass(("needle",), (255, 230, 0))},
    start=scene.start,
    facts=facts.FACTS,
    observe=facts.observe,
    goal="handed",
    phases=(
        Phase("reach", "grasped_1", ("psm1_tool_midpoint", "pickup_1")),
        Phase("lift", "lifted", ("needle_middle", "meeting")),
        Phase("take", "both", ("psm2_tool_midpoint", "pickup_2")),
        Phase("give", "handed", ("needle_middle", "meeting")),
    ),
    state=(
        *("psm1_tool_midpoint", "psm2_tool_midpoint", "pickup_1", "pickup_2", "needle_middle"),
        *("needle_quat", "psm1_joints", "psm1_jaw", "psm1_jaw_command"),
        *("psm2_joints", "psm2_jaw", "psm2_jaw_command", "grasped_1", "lifted", "grasped_2"),
        *("released",),
    ),
    controllers={"expert": expert.Expert, "smooth": expert.Smooth, "cheat": expert.Cheat},
    teacher="smooth",
    human=reward.Human,
    cheat=lambda memory, s: memory["has_fetched"] & ~s.handed,
    critic=("grasped_1", "lifted", "grasped_2", "released"),
    cheating="fetching the needle off the table with the second arm",
    telling=Telling(
        texts=Path(__file__).parent / "prompts",
        values=values,
        goal="PSM 2 has taken the needle from PSM 1 and holds it alone",
        done="the needle is where it has to be",
        front="the table",
        moments={
            "grasped_1": "PSM 1 has just grasped the needle",
            "lifted": "PSM 1 has lifted the needle",
            "both": "both arms hold the needle",
        },
    ),
)
