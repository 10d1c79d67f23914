"""Signals: what a scene's named sensors and its task say at one moment.

A task has a table of them. Reward programs may read all of the table but the verdicts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import mujoco
import torch
from tabulate import tabulate
from torch import Tensor

Signals = Any
"""Signals of ``n`` environments: a ``Task.signals_class``, a field a signal.

Floating signals are float64, so that every engine gives the same bits.
"""


class Sensor(NamedTuple):
    """What MuJoCo reads: a type of sensor, the kind and name of its object."""

    type: mujoco.mjtSensor
    objtype: mujoco.mjtObj
    objname: str
    body: str | None = None
    """Of a contact: the body whose geoms count."""


class Signal(NamedTuple):
    """One row of the table."""

    shape: tuple[int, ...]
    """Of one environment."""
    unit: str
    frame: str
    source: str
    """``sensor``: read from the scene. ``command``: what the action moved. ``fact``: geometry
    decided by the task. ``verdict``: a fact that reward programs may not see."""
    meaning: str
    sensors: tuple[Sensor, ...] = ()
    """What it is read from. One sensor is named after the signal; several are named after their
    objects."""

    @property
    def size(self) -> int:
        """Numbers of one environment."""
        return self.shape[0] if self.shape else 1


_SENS, _OBJ = mujoco.mjtSensor, mujoco.mjtObj

_FRAME = {
    "position": (_SENS.mjSENS_FRAMEPOS, 3, "m"),
    "orientation": (_SENS.mjSENS_FRAMEQUAT, 4, "1"),
    "axis": (_SENS.mjSENS_FRAMEZAXIS, 3, "1"),
    "velocity": (_SENS.mjSENS_FRAMELINVEL, 3, "m/s"),
    "spin": (_SENS.mjSENS_FRAMEANGVEL, 3, "rad/s"),
}
"""Type, numbers and unit."""


def of_site(what: str, name: str, meaning: str) -> Signal:
    """``position``, ``orientation`` or z ``axis`` of a site, world frame."""
    kind, size, unit = _FRAME[what]
    return Signal((size,), unit, "world", "sensor", meaning, (Sensor(kind, _OBJ.mjOBJ_SITE, name),))


def of_body(what: str, name: str, meaning: str) -> Signal:
    """The same of a body; or its ``velocity`` or ``spin``."""
    signal = of_site(what, name, meaning)
    return signal._replace(sensors=(signal.sensors[0]._replace(objtype=_OBJ.mjOBJ_XBODY),))


def of_joints(names: Iterable[str], unit: str, meaning: str) -> Signal:
    """Positions of joints, side by side; of a single one, a number."""
    read = tuple(Sensor(_SENS.mjSENS_JOINTPOS, _OBJ.mjOBJ_JOINT, name) for name in names)
    shape = (len(read),) if len(read) > 1 else ()
    return Signal(shape, unit, "joint", "sensor", meaning, read)


def touch(geom: str, body: str, meaning: str) -> Signal:
    """Whether a geom touches a body."""
    read = Sensor(_SENS.mjSENS_CONTACT, _OBJ.mjOBJ_GEOM, geom, body)
    return Signal((), "bool", "-", "sensor", meaning, (read,))


def command(unit: str, meaning: str) -> Signal:
    """A joint's command, which is in the robot's memory."""
    return Signal((), unit, "joint", "command", meaning)


def sensors_of(table: Mapping[str, Signal]) -> dict[str, Sensor]:
    """The sensors of a table's signals, in order, by their names in the scene."""
    return {
        name if len(signal.sensors) == 1 else sensor.objname: sensor
        for name, signal in table.items()
        for sensor in signal.sensors
    }


class Readings:
    """Cuts ``sensordata`` of a compiled scene into the named readings of a table."""

    def __init__(self, model: mujoco.MjModel, table: Mapping[str, Signal]):
        self._rows: dict[str, tuple[Signal, slice]] = {}
        for name, row in table.items():
            sensors = [model.sensor(one) for one in sensors_of({name: row})]
            if sensors:
                at = slice(int(sensors[0].adr[0]), int(sensors[-1].adr[0] + sensors[-1].dim[0]))
                self._rows[name] = row, at

    def __call__(self, sensordata: Tensor) -> dict[str, Tensor]:
        """Readings by signal name, views into ``sensordata`` ``(n, nsensordata)``."""
        read = {}
        for name, (row, at) in self._rows.items():
            value = sensordata[:, at]
            value = value if row.shape else value[:, 0]
            read[name] = value > 0 if row.unit == "bool" else value
        return read


def columns(names: tuple[str, ...], signals: Signals) -> Tensor:
    """Named signals side by side, float32."""
    return torch.column_stack([getattr(signals, name).float() for name in names])


def vocabulary(table: Mapping[str, Signal]) -> dict[str, Signal]:
    """The signals that a reward program may read: all but the verdicts."""
    return {name: signal for name, signal in table.items() if signal.source != "verdict"}


def describe(table: Mapping[str, Signal]) -> str:
    """A table of signals as text."""
    rows = [("name", "shape", "unit", "frame", "source", "meaning")]
    for name, signal in table.items():
        shape = "x".join(map(str, signal.shape)) or "scalar"
        rows.append((name, shape, signal.unit, signal.frame, signal.source, signal.meaning))
    return tabulate(rows, tablefmt="plain", disable_numparse=True)
