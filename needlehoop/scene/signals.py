"""Signals: what a scene's named sensors and its task say at one moment.

A task has a table of them. The table is also the vocabulary that reward programs are written in;
a signal that would give the verdict away is left out of that.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import torch
from torch import Tensor

Signals = Any
"""Signals of ``n`` environments: a TensorClass of ``signals_class``, a field a signal.

Floating signals are float64, so that every engine gives the same bits.
"""


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

    @property
    def size(self) -> int:
        """Numbers of one environment."""
        return self.shape[0] if self.shape else 1


class SensorSpec(NamedTuple):
    """A named sensor: its MuJoCo type, the kind and name of the object that it reads."""

    type: mujoco.mjtSensor
    objtype: mujoco.mjtObj
    objname: str
    body: str | None = None
    """Of a contact: the body whose geoms count."""
    signal: str | None = None
    """The signal that it is a part of, in the order of sensors; ``None``: that of its own name."""


ELAPSED = Signal((), "1", "-", "command", "fraction of the episode's steps that is used up")


def signals_class(table: Mapping[str, Signal]) -> type:
    """The TensorClass with a field for each signal of a table."""
    # Imported where signals are made: it takes a second, which bad settings need not wait for.
    from tensordict import TensorClass

    fields = {"__annotations__": dict.fromkeys(table, Tensor), "__module__": __name__}
    return type("Signals", (TensorClass,), fields)


class Readings:
    """Cuts ``sensordata`` into named readings.

    Args:
        model: a compiled scene.
        sensors: of the scene, by name.
        table: of signals.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sensors: Mapping[str, SensorSpec],
        table: Mapping[str, Signal],
    ):
        self._slices: dict[str, list[slice]] = {}
        self._table = table
        for name, spec in sensors.items():
            sensor = model.sensor(name)
            start, size = int(sensor.adr[0]), int(sensor.dim[0])
            self._slices.setdefault(spec.signal or name, []).append(slice(start, start + size))

    def __call__(self, sensordata: Tensor) -> dict[str, Tensor]:
        """Readings by signal name from ``sensordata`` ``(n, nsensordata)``: views where whole."""
        read = {}
        for name, parts in self._slices.items():
            columns = [sensordata[:, part] for part in parts]
            value = columns[0] if len(columns) == 1 else torch.cat(columns, -1)
            row = self._table[name]
            value = value if row.shape else value[:, 0]
            read[name] = value > 0 if row.unit == "bool" else value
        return read


def columns(names: tuple[str, ...], signals: Signals) -> Tensor:
    """Named signals side by side, float32."""
    parts = []
    for name in names:
        value = getattr(signals, name).float()
        parts.append(value if value.ndim == 2 else value.unsqueeze(-1))
    return torch.cat(parts, -1)


def vocabulary(table: Mapping[str, Signal]) -> dict[str, Signal]:
    """The signals that a reward program may read: all but the verdicts."""
    return {name: signal for name, signal in table.items() if signal.source != "verdict"}


def describe(table: Mapping[str, Signal]) -> str:
    """A table of signals as text."""
    rows = [("name", "shape", "unit", "frame", "source", "meaning")]
    for name, signal in table.items():
        shape = "x".join(map(str, signal.shape)) or "scalar"
        rows.append((name, shape, signal.unit, signal.frame, signal.source, signal.meaning))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row[:5], widths, strict=True))
        + f"  {row[5]}"
        for row in rows
    )
    return "\n".join(lines)
