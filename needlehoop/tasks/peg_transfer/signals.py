"""The table of signals of the peg transfer, in words."""

from __future__ import annotations

from needlehoop.scene.signals import ELAPSED, Signal
from needlehoop.tasks.psm import JAW_COMMAND, JOINT_SIGNALS, TOOL_SIGNALS

TABLE: dict[str, Signal] = {
    **TOOL_SIGNALS,
    "pickup_point": Signal(
        (3,), "m", "world", "sensor", "where the block should be grasped: in one of its walls"
    ),
    "block_position": Signal((3,), "m", "world", "sensor", "middle of the block and of its hole"),
    "block_quat": Signal(
        (4,),
        "1",
        "world",
        "sensor",
        "block frame: z along the hole, x from the hole through the wall that is to be grasped",
    ),
    "block_velocity": Signal((3,), "m/s", "world", "sensor", "of the block's middle"),
    "block_spin": Signal((3,), "rad/s", "world", "sensor", "angular velocity of the block"),
    "goal": Signal(
        (3,), "m", "world", "sensor", "middle of a block that stands over the marked peg"
    ),
    "above_goal": Signal(
        (3,), "m", "world", "sensor", "middle of a block that is carried above the marked peg"
    ),
    "lift_position": Signal(
        (3,), "m", "world", "sensor", "above the block's start, at the height of above_goal"
    ),
    **JOINT_SIGNALS,
    "jaw_1_touch": Signal((), "bool", "-", "sensor", "first jaw touches the block"),
    "jaw_2_touch": Signal((), "bool", "-", "sensor", "second jaw touches the block"),
    "jaw_command": JAW_COMMAND,
    "elapsed": ELAPSED,
    "grasped": Signal((), "bool", "-", "fact", "the block is held"),
    "lifted": Signal(
        (), "bool", "-", "fact", "the block's lower edge is above the marked peg's top"
    ),
    "arrived": Signal(
        (),
        "bool",
        "-",
        "verdict",
        "the block is at the marked peg, lower than its top: about it or beside it",
    ),
    "over": Signal(
        (), "bool", "-", "verdict", "the marked peg's axis runs through the block's hole"
    ),
    "placed": Signal(
        (),
        "bool",
        "-",
        "verdict",
        "the block stands over the marked peg, on the board, released and at rest",
    ),
}

STATE = (
    *("tool_midpoint", "pickup_point", "block_position", "block_quat", "goal"),
    *("joints", "jaw", "jaw_command", "grasped", "lifted"),
)
"""What ``obs=signals`` reports: enough to do the task without eyes."""
