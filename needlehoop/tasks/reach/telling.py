"""Reach in words, for a model."""

from __future__ import annotations

from pathlib import Path

from needlehoop.tasks.contract import Telling
from needlehoop.tasks.layout import millimetres
from needlehoop.tasks.psm import arm_values
from needlehoop.tasks.reach.layout import BUMPS, ReachLayout, ReachRules


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


TELLING = Telling(
    texts=Path(__file__).parent / "prompts",
    values=values,
    goal="the tips of the jaws are at the button",
    done="the point between the jaws' tips is where it has to be",
    front="the phantom",
)
