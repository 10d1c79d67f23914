"""The table of signals: what the scene's sensors and the task say, in words.

It is also the vocabulary that reward programs are written in, so a signal that would give
the verdict away (``touched``, ``threaded``) is left out of it.
"""

from __future__ import annotations

from typing import NamedTuple

from needlehoop.robot.joints import JOINT_NAMES

FACTS = (
    *("grasped", "lifted", "touched", "threaded", "success"),
    *("cheat", "has_grasped", "has_touched", "diverged"),
)
"""What is known of an environment besides its signals: of the moment, then of the episode."""


class Signal(NamedTuple):
    """One row of the table: per-environment shape, unit, frame, source and meaning.

    ``source`` is ``sensor`` (read from the scene), ``command`` (what the action moved),
    ``fact`` (geometry decided by the task) or ``verdict`` (a fact that rewards written by
    others may not see).
    """

    shape: tuple[int, ...]
    unit: str
    frame: str
    source: str
    meaning: str


TABLE: dict[str, Signal] = {
    "tool_midpoint": Signal((3,), "m", "world", "sensor", "point between the jaws' tips"),
    "tool_quat": Signal(
        (4,),
        "1",
        "world",
        "sensor",
        "tool frame: x along the jaws' hinge, y the way they open, z from the hinge to their tips",
    ),
    "wrist_pos": Signal((3,), "m", "world", "sensor", "wrist-yaw joint"),
    "wrist_quat": Signal((4,), "1", "world", "sensor", "wrist-yaw link"),
    "pickup_point": Signal((3,), "m", "world", "sensor", "where the needle should be grasped"),
    "needle_tip": Signal((3,), "m", "world", "sensor", "the needle's sharp end"),
    "needle_quat": Signal(
        (4,),
        "1",
        "world",
        "sensor",
        "needle frame at the pickup point: y towards the sharp end, x towards the arc's centre",
    ),
    "goal": Signal((3,), "m", "world", "sensor", "centre of the hoop's opening"),
    "hoop_axis": Signal(
        (3,), "1", "world", "sensor", "unit vector through the opening: the world's y"
    ),
    "lift_position": Signal(
        (3,), "m", "world", "sensor", "above the pickup point's start, at the goal's height"
    ),
    "joints": Signal((6,), "rad, m", "joint", "sensor", ", ".join(JOINT_NAMES)),
    "jaw": Signal((), "rad", "joint", "sensor", "angle between the jaws, 0 where they are closed"),
    "jaw_1_touch": Signal((), "bool", "-", "sensor", "first jaw touches the needle"),
    "jaw_2_touch": Signal((), "bool", "-", "sensor", "second jaw touches the needle"),
    "jaw_command": Signal((), "rad", "joint", "command", "commanded angle between the jaws"),
    "elapsed": Signal((), "1", "-", "command", "fraction of the episode's steps that is used up"),
    "grasped": Signal((), "bool", "-", "fact", "the needle is held"),
    "lifted": Signal(
        (), "bool", "-", "fact", "the held needle has reached the lift position; stays true"
    ),
    "touched": Signal((), "bool", "-", "verdict", "the tip is within the goal's radius"),
    "threaded": Signal((), "bool", "-", "verdict", "the held needle passes through the opening"),
}


def vocabulary() -> dict[str, Signal]:
    """The signals a reward program may read: all but the verdicts."""
    return {name: signal for name, signal in TABLE.items() if signal.source != "verdict"}


def describe(table: dict[str, Signal] | None = None) -> str:
    """A table of signals as text; by default the vocabulary."""
    rows = [("name", "shape", "unit", "frame", "source", "meaning")]
    for name, signal in (table or vocabulary()).items():
        shape = "x".join(map(str, signal.shape)) or "scalar"
        rows.append((name, shape, signal.unit, signal.frame, signal.source, signal.meaning))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row[:5], widths, strict=True))
        + f"  {row[5]}"
        for row in rows
    )
    return "\n".join(lines)
