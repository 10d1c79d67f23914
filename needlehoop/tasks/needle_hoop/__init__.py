"""Needle and hoop, the paper's task: pick a suture needle off a table and pass it through a hoop.

``needle`` is the needle's shape, ``scene`` what there is and where an episode begins, ``facts``
what is true, ``expert`` who can do it, ``reward`` what the paper's author pays.
"""

import math
from pathlib import Path

import numpy as np

from needlehoop.tasks.contract import FlatClass, Phase, Task, Telling
from needlehoop.tasks.layout import millimetres
from needlehoop.tasks.needle_hoop import expert, facts, reward, scene
from needlehoop.tasks.needle_hoop.scene import NeedleLayout, NeedleRules
from needlehoop.tasks.psm import ROBOT, arm_values, grasped


def values(layout: NeedleLayout, rules: NeedleRules) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    x, y, z = layout.hoop_position
    pickup = (*layout.needle_position, layout.needle_thickness / 2)
    return {
        **arm_values(layout, rules),
        "needle_arc": round(math.degrees(layout.needle_arc)),
        "sharp": "nearer to" if sharp_end_is_nearer(layout) else "farther from",
        "hoop_height": round(1000 * z),
        "hoop_away": round(1000 * math.dist((x, y), layout.needle_position)),
        "tool_away": round(1000 * math.dist(layout.tool_position, pickup)),
        "side": "in front of" if layout.needle_position[1] < y else "behind",
        "hand": "to the right" if layout.needle_position[0] > x else "to the left",
        "pickup": f"{100 * layout.needle_pickup:g}",
        "grasped": grasped(rules, "the needle"),
        "lift_radius": millimetres(rules.lift_radius),
    }


def sharp_end_is_nearer(layout: NeedleLayout) -> bool:
    """Whether the sharp end of a needle in its nominal place is the end nearer to the hoop."""
    cos, sin = math.cos(layout.needle_yaw), math.sin(layout.needle_yaw)
    ends = layout.centre_line(np.array(layout.needle_angles))[:, :2] @ np.array(
        [[cos, sin], [-sin, cos]]
    )
    away = np.linalg.norm(ends + layout.needle_position - layout.hoop_position[:2], axis=1)
    return bool(away[1] < away[0])


TASK = Task(
    name="needle_hoop",
    summary="Pick a suture needle off a table and pass it through a hoop.",
    robot=ROBOT,
    layout=NeedleLayout,
    rules=NeedleRules,
    materials=scene.MATERIALS,
    build=scene.build,
    things=scene.THINGS,
    holds="needle",
    classes={
        "needle": FlatClass(("needle",), (255, 230, 0)),
        "hoop": FlatClass(("hoop",), (255, 0, 80)),
    },
    start=scene.start,
    facts=facts.FACTS,
    observe=facts.observe,
    goal="threaded",
    success=lambda rules, s: s.touched if rules.success == "touch" else s.threaded,
    phases=(
        Phase("reach", "grasped", ("tool_midpoint", "pickup_point")),
        Phase("lift", "lifted", ("pickup_point", "goal")),
        Phase("insert", "threaded", ("needle_tip", "goal")),
    ),
    state=(
        *("tool_midpoint", "pickup_point", "needle_tip", "goal", "lift_position", "needle_quat"),
        *("joints", "jaw", "jaw_command", "grasped", "lifted"),
    ),
    controllers={"expert": expert.Expert, "smooth": expert.Smooth, "cheat": expert.Cheat},
    teacher="smooth",
    human=reward.Human,
    cheat=lambda memory, s: memory["has_touched"] & ~s.threaded,
    critic=("grasped", "lifted"),
    cheating="touching the goal without threading",
    telling=Telling(
        texts=Path(__file__).parent / "prompts",
        values=values,
        goal="the needle is through the hoop",
        done="the needle is where it has to be",
        front="the hoop",
        moments={
            "grasped": "the needle has just been grasped",
            "lifted": "the needle is lifted",
        },
        painted={
            "hoop": "the rod under the ring counts as hoop, the rest of its stand as all else"
        },
    ),
)
