"""Peg transfer, the first exercise of the FLS curriculum: a hollow block goes from peg to peg.

``scene`` says what there is and where an episode begins, ``facts`` what is true, ``expert`` who
can do it, ``reward`` what a person would pay. ``docs/peg_transfer.md`` says where the sizes are
from.
"""

from collections.abc import Sequence
from pathlib import Path

from needlehoop.tasks.contract import FlatClass, Phase, Task, Telling
from needlehoop.tasks.layout import millimetres
from needlehoop.tasks.peg_transfer import expert, facts, reward, scene
from needlehoop.tasks.peg_transfer.scene import OTHER_PEGS, PEGS, WALLS, PegLayout, PegRules
from needlehoop.tasks.psm import ROBOT, arm_values, grasped


def values(layout: PegLayout, rules: PegRules) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    return {
        **arm_values(layout, rules),
        "walls": len(WALLS),
        "wall_length": millimetres(layout.wall_length),
        "pegs": PEGS,
        "others": PEGS - 1,
        "tool_height": round(1000 * layout.tool_position[2]),
        "places": _places(layout, range(PEGS)),
        "starts": _places(layout, layout.starts),
        "goals": _places(layout, layout.goals),
        "grasped": grasped(rules, "a wall of the block"),
    }


def _places(layout: PegLayout, pegs: Sequence[int]) -> str:
    """Nominal places of pegs, x and y in mm."""
    return ", ".join(
        f"({millimetres(x)}, {millimetres(y)})" for x, y in (layout.pegs[peg] for peg in pegs)
    )


TASK = Task(
    name="peg_transfer",
    summary="Lift a hollow block off its peg, put it over the marked peg and let go.",
    robot=ROBOT,
    layout=PegLayout,
    rules=PegRules,
    materials=scene.MATERIALS,
    build=scene.build,
    things=scene.THINGS,
    holds="block",
    classes={
        "block": FlatClass(("block",), (255, 60, 0)),
        "marked": FlatClass(("marked",), (0, 255, 60)),
        "pegs": FlatClass(OTHER_PEGS, (255, 255, 255)),
    },
    start=scene.start,
    facts=facts.FACTS,
    observe=facts.observe,
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
    controllers={"expert": expert.Expert, "smooth": expert.Smooth, "cheat": expert.Cheat},
    teacher="smooth",
    human=reward.Human,
    # It lies or leans beside the peg, was taken away again, or is held over it and not let go.
    cheat=lambda memory, s: memory["has_arrived"] & ~s.placed,
    critic=("grasped", "lifted"),
    cheating="holding the block about the marked peg without letting go",
    telling=Telling(
        texts=Path(__file__).parent / "prompts",
        values=values,
        goal="the block stands over the marked peg and has been let go",
        done="the block is where it has to be",
        front="the board",
        moments={"grasped": "the block has just been grasped", "lifted": "the block is lifted"},
    ),
)
