"""Needle and hoop, the paper's task: pick a suture needle off a table and pass it through a hoop.

``scene`` says what there is, ``layout`` how large it is and where an episode begins,
``facts`` what is true, ``expert`` who can do it, ``reward`` what the paper's author pays.
"""

from needlehoop.tasks.contract import FlatClass, Phase, Task
from needlehoop.tasks.needle_hoop.expert import cheat as cheat_script
from needlehoop.tasks.needle_hoop.expert import expert, smooth
from needlehoop.tasks.needle_hoop.facts import FACTS, cheat, observe, success
from needlehoop.tasks.needle_hoop.layout import DRAWS, NeedleLayout, NeedleRules, start
from needlehoop.tasks.needle_hoop.reward import Human
from needlehoop.tasks.needle_hoop.scene import MATERIALS, SIGNALS, build
from needlehoop.tasks.needle_hoop.telling import TELLING
from needlehoop.tasks.psm import ROBOT

TASK = Task(
    name="needle_hoop",
    summary="Pick a suture needle off a table and pass it through a hoop.",
    robot=ROBOT,
    layout=NeedleLayout,
    rules=NeedleRules,
    materials=MATERIALS,
    build=build,
    signals=SIGNALS,
    classes={
        "needle": FlatClass(("needle",), (255, 230, 0)),
        "hoop": FlatClass(("hoop",), (255, 0, 80)),
    },
    draws=DRAWS,
    start=start,
    facts=FACTS,
    observe=observe,
    goal="threaded",
    success=success,
    phases=(
        Phase("reach", "grasped", ("tool_midpoint", "pickup_point")),
        Phase("lift", "lifted", ("pickup_point", "goal")),
        Phase("insert", "threaded", ("needle_tip", "goal")),
    ),
    state=(
        *("tool_midpoint", "pickup_point", "needle_tip", "goal", "lift_position", "needle_quat"),
        *("joints", "jaw", "jaw_command", "grasped", "lifted"),
    ),
    controllers={"expert": expert, "smooth": smooth, "cheat": cheat_script},
    teacher="smooth",
    human=Human,
    cheat=cheat,
    critic=("grasped", "lifted"),
    cheating="touching the goal without threading",
    telling=TELLING,
)
