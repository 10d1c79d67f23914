"""The peg transfer in words, for a model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from needlehoop.tasks.contract import Telling
from needlehoop.tasks.layout import millimetres
from needlehoop.tasks.peg_transfer.layout import PEGS, WALLS, PegLayout, PegRules
from needlehoop.tasks.psm import arm_values, grasped


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
        "grasped": grasped(rules, "block", "a wall of the block"),
    }


def _places(layout: PegLayout, pegs: Sequence[int]) -> str:
    """Nominal places of pegs, x and y in mm."""
    return ", ".join(
        f"({millimetres(x)}, {millimetres(y)})" for x, y in (layout.pegs[peg] for peg in pegs)
    )


TELLING = Telling(
    texts=Path(__file__).parent / "prompts",
    values=values,
    goal="the block stands over the marked peg and has been let go",
    done="the block is where it has to be",
    front="the board",
    moments={"grasped": "the block has just been grasped", "lifted": "the block is lifted"},
)
