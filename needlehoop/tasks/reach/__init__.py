"""Reach: bring the instrument's tip to a raised button on an uneven phantom, and stay there.

``scene`` says what there is, ``layout`` how large it is, where an episode begins
and when a fact holds; ``facts`` what is true, ``expert`` who can do it, ``reward`` what a
person would pay.
"""

from needlehoop.tasks.contract import FlatClass, Phase, Task
from needlehoop.tasks.psm import ROBOT
from needlehoop.tasks.reach.expert import expert, smooth
from needlehoop.tasks.reach.facts import FACTS, observe
from needlehoop.tasks.reach.layout import BUMPS, DRAWS, ReachLayout, ReachRules, start
from needlehoop.tasks.reach.reward import Human
from needlehoop.tasks.reach.scene import MATERIALS, SIGNALS, build
from needlehoop.tasks.reach.telling import TELLING

TASK = Task(
    name="reach",
    summary="Bring the instrument's tip to the raised button among flat marks, and stay there.",
    robot=ROBOT,
    layout=ReachLayout,
    rules=ReachRules,
    materials=MATERIALS,
    build=build,
    signals=SIGNALS,
    classes={
        "target": FlatClass(("target",), (255, 230, 0)),
        "marks": FlatClass(tuple(f"mark_{i}" for i in range(BUMPS)), (255, 0, 80)),
        "phantom": FlatClass(tuple(f"bump_{i}" for i in range(BUMPS)), (0, 150, 60)),
    },
    draws=DRAWS,
    start=start,
    facts=FACTS,
    observe=observe,
    goal="stayed",
    phases=(
        Phase("approach", "near", ("tool_midpoint", "target")),
        Phase("stay", "stayed", ("tool_midpoint", "target")),
    ),
    state=("tool_midpoint", "target", "joints", "jaw", "jaw_command"),
    controllers={"expert": expert, "smooth": smooth},
    teacher="smooth",
    human=Human,
    telling=TELLING,
)
