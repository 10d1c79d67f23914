"""Peg transfer, the first exercise of the FLS curriculum: a hollow block goes from peg to peg.

``scene`` says what there is, ``layout`` how large it is and where an episode begins,
``facts`` what is true, ``expert`` who can do it, ``reward`` what a person would pay.
``docs/peg_transfer.md`` says where the sizes are from.
"""

from needlehoop.tasks.contract import FlatClass, Phase, Task
from needlehoop.tasks.peg_transfer.expert import cheat as cheat_script
from needlehoop.tasks.peg_transfer.expert import expert, smooth
from needlehoop.tasks.peg_transfer.facts import FACTS, cheat, observe
from needlehoop.tasks.peg_transfer.layout import DRAWS, OTHER_PEGS, PegLayout, PegRules, start
from needlehoop.tasks.peg_transfer.reward import Human
from needlehoop.tasks.peg_transfer.scene import MATERIALS, SIGNALS, build
from needlehoop.tasks.peg_transfer.telling import TELLING
from needlehoop.tasks.psm import ROBOT

TASK = Task(
    name="peg_transfer",
    summary="Lift a hollow block off its peg, put it over the marked peg and let go.",
    robot=ROBOT,
    layout=PegLayout,
    rules=PegRules,
    materials=MATERIALS,
    build=build,
    signals=SIGNALS,
    classes={
        "block": FlatClass(("block",), (255, 60, 0)),
        "marked": FlatClass(("marked",), (0, 255, 60)),
        "pegs": FlatClass(OTHER_PEGS, (255, 255, 255)),
    },
    draws=DRAWS,
    start=start,
    facts=FACTS,
    observe=observe,
    goal="placed",
    phases=(
        Phase("reach", "grasped", ("tool_midpoint", "pickup_point")),
        Phase("lift", "lifted", ("block_position", "lift_position")),
        Phase("carry", "over", ("block_position", "above_goal")),
        Phase("place", "placed", ("block_position", "goal")),
    ),
    state=(
        *("tool_midpoint", "pickup_point", "block_position", "block_quat", "goal"),
        *("joints", "jaw", "jaw_command", "grasped", "lifted"),
    ),
    controllers={"expert": expert, "smooth": smooth, "cheat": cheat_script},
    teacher="smooth",
    human=Human,
    cheat=cheat,
    critic=("grasped", "lifted"),
    cheating="holding the block about the marked peg without letting go",
    telling=TELLING,
)
