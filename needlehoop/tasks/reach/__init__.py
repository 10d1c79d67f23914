"""Reach: bring the instrument's tip to a raised button on an uneven phantom, and stay there.

``scene`` says what there is, where an episode begins and what is true, ``expert`` who can do it,
``reward`` what a person would pay.
"""

from pathlib import Path

from needlehoop.scene.signals import of_body
from needlehoop.tasks.contract import FlatClass, Phase, Task, Telling
from needlehoop.tasks.layout import millimetres
from needlehoop.tasks.psm import ROBOT, arm_values
from needlehoop.tasks.reach import expert, reward, scene
from needlehoop.tasks.reach.scene import BUMPS, ReachLayout, ReachRules


def values(layout: ReachLayout, rules: ReachRules) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    height, spread = layout.bump_height, layout.bump_height_range
    return {
        **arm_values(layout, rules),
        "bumps": BUMPS,
        "thinnest": millimetres(min(layout.bump_radii)),
        "thickest": millimetres(max(layout.bump_radii)),
        "lowest": millimetres(height - spread),
        "highest": millimetres(height + spread),
        "target_above_bump": millimetres(layout.target_above_bump),
        "tool_height": round(1000 * layout.tool_position[2]),
    }


TASK = Task(
    name="reach",
    summary="Bring the instrument's tip to the raised button among flat marks, and stay there.",
    robot=ROBOT,
    layout=ReachLayout,
    rules=ReachRules,
    materials=scene.MATERIALS,
    build=scene.build,
    things={"target": of_body("position", "target", "point just above the middle of the button")},
    classes={
        "target": FlatClass(("target",), (255, 230, 0)),
        "marks": FlatClass(tuple(f"mark_{i}" for i in range(BUMPS)), (255, 0, 80)),
        "phantom": FlatClass(tuple(f"bump_{i}" for i in range(BUMPS)), (0, 150, 60)),
    },
    start=scene.start,
    facts=scene.FACTS,
    observe=scene.observe,
    goal="stayed",
    phases=(
        Phase("approach", "near", ("tool_midpoint", "target")),
        Phase("stay", "stayed", ("tool_midpoint", "target")),
    ),
    state=("tool_midpoint", "target", "joints", "jaw", "jaw_command"),
    controllers={"expert": expert.Expert, "smooth": expert.Smooth},
    teacher="smooth",
    human=reward.Human,
    telling=Telling(
        texts=Path(__file__).parent / "prompts",
        values=values,
        goal="the tips of the jaws are at the button",
        done="the point between the jaws' tips is where it has to be",
        front="the phantom",
    ),
)
