"""Signals: what the scene's named sensors and the task say at one moment.

The table of signals is also the vocabulary that reward programs are written in, so a
signal that would give the verdict away (``touched``, ``threaded``) is left out of it.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import torch
from tensordict import TensorClass
from torch import Tensor

from needlehoop.robot.psm import JOINT_NAMES
from needlehoop.scene.spec import SENSORS


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
    "tool_quat": Signal((4,), "1", "world", "sensor", "tool frame: z along the jaws, x their axis"),
    "wrist_pos": Signal((3,), "m", "world", "sensor", "wrist-yaw joint"),
    "wrist_quat": Signal((4,), "1", "world", "sensor", "wrist-yaw link"),
    "pickup_point": Signal((3,), "m", "world", "sensor", "where the needle should be grasped"),
    "needle_tip": Signal((3,), "m", "world", "sensor", "the needle's sharp end"),
    "needle_quat": Signal(
        (4,), "1", "world", "sensor", "needle frame: y along it at the pickup point"
    ),
    "goal": Signal((3,), "m", "world", "sensor", "centre of the hoop's opening"),
    "hoop_axis": Signal((3,), "1", "world", "sensor", "unit vector through the opening"),
    "lift_position": Signal(
        (3,), "m", "world", "sensor", "above the pickup point's start, at the goal's height"
    ),
    "joints": Signal((6,), "rad, m", "joint", "sensor", ", ".join(JOINT_NAMES)),
    "jaw": Signal((), "rad", "joint", "sensor", "angle between the jaws"),
    "jaw_1_touch": Signal((), "bool", "-", "sensor", "first jaw touches the needle"),
    "jaw_2_touch": Signal((), "bool", "-", "sensor", "second jaw touches the needle"),
    "jaw_command": Signal((), "rad", "joint", "command", "commanded angle between the jaws"),
    "elapsed": Signal((), "1", "-", "command", "fraction of the episode's steps that is used up"),
    "grasped": Signal((), "bool", "-", "fact", "the needle is held"),
    "lifted": Signal((), "bool", "-", "fact", "the held needle has reached the lift position"),
    "touched": Signal((), "bool", "-", "verdict", "the tip is within the goal's radius"),
    "threaded": Signal((), "bool", "-", "verdict", "the held needle passes through the opening"),
}


class Signals(TensorClass):
    """Signals of ``n`` environments; shapes, units and frames are in ``TABLE``.

    Floating signals are float64, so that every engine gives the same bits.
    """

    tool_midpoint: Tensor
    tool_quat: Tensor
    wrist_pos: Tensor
    wrist_quat: Tensor
    pickup_point: Tensor
    needle_tip: Tensor
    needle_quat: Tensor
    goal: Tensor
    hoop_axis: Tensor
    lift_position: Tensor
    joints: Tensor
    jaw: Tensor
    jaw_1_touch: Tensor
    jaw_2_touch: Tensor
    jaw_command: Tensor
    elapsed: Tensor
    grasped: Tensor
    lifted: Tensor
    touched: Tensor
    threaded: Tensor


class Readings:
    """Cuts ``sensordata`` into named readings.

    Args:
        model: a compiled scene.
    """

    def __init__(self, model: mujoco.MjModel):
        self._slices = {}
        for name in SENSORS:
            sensor = model.sensor(name)
            start, size = int(sensor.adr[0]), int(sensor.dim[0])
            self._slices[name] = slice(start, start + size)

    def __call__(self, sensordata: Tensor) -> dict[str, Tensor]:
        """Readings by signal name from ``sensordata`` ``(n, nsensordata)``: views of it."""
        read = {}
        for name in TABLE:
            if name in self._slices:
                value = sensordata[:, self._slices[name]]
                read[name] = value if TABLE[name].shape else value[:, 0]
        read["joints"] = torch.cat([sensordata[:, self._slices[name]] for name in JOINT_NAMES], -1)
        for name in ("jaw_1_touch", "jaw_2_touch"):
            read[name] = read[name] > 0
        return read


PROPRIO_SIZE = 8
"""Numbers in ``proprio``."""


def proprio(signals: Signals) -> Tensor:
    """What the robot knows of itself: six joints, jaw, jaw command; ``(n, 8)`` float32."""
    columns = (signals.joints, signals.jaw.unsqueeze(-1), signals.jaw_command.unsqueeze(-1))
    return torch.cat(columns, -1).float()


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
