"""The table of signals of needle and hoop, in words."""

from __future__ import annotations

from needlehoop.scene.signals import ELAPSED, Signal
from needlehoop.tasks.psm import JAW_COMMAND, JOINT_SIGNALS, TOOL_SIGNALS

TABLE: dict[str, Signal] = {
    **TOOL_SIGNALS,
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
    **JOINT_SIGNALS,
    "jaw_1_touch": Signal((), "bool", "-", "sensor", "first jaw touches the needle"),
    "jaw_2_touch": Signal((), "bool", "-", "sensor", "second jaw touches the needle"),
    "jaw_command": JAW_COMMAND,
    "elapsed": ELAPSED,
    "grasped": Signal((), "bool", "-", "fact", "the needle is held"),
    "lifted": Signal(
        (), "bool", "-", "fact", "the held needle has reached the lift position; stays true"
    ),
    "touched": Signal((), "bool", "-", "verdict", "the tip is within the goal's radius"),
    "threaded": Signal((), "bool", "-", "verdict", "the held needle passes through the opening"),
}

STATE = (
    *("tool_midpoint", "pickup_point", "needle_tip", "goal", "lift_position", "needle_quat"),
    *("joints", "jaw", "jaw_command", "grasped", "lifted"),
)
"""What ``obs=signals`` reports: enough to do the task without eyes."""
