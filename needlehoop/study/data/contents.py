"""Checks and reads what files hold: tables, films, pictures, and what a manifest says of a task."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field, StringConstraints, TypeAdapter, ValidationError

from needlehoop.runs.reading import UnreadableError, read_bytes, read_text

LARGEST = float(2**53)
"""No number of a run is larger: sums and axes would overflow, and whole numbers are none."""

Rows = Mapping[str, np.ndarray]
"""A table of numbers, ``(n,)`` for each column; NaN where a cell is empty."""

Ranges = Mapping[str, tuple[float, float]]
"""The lowest and the highest number that may stand under each name."""

RETURN_RANGE = (-1e9, 1e9)
_KNOWN: Ranges = {"return": RETURN_RANGE, "success": (0.0, 1.0)}
"""Columns of each table of a run; empty in a row in which no episode ended."""

_RISING = ("update", "step")

_FILM, _PICTURE = (b"moov",), (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82")
"""What an MP4 file has at its end, and a PNG file at its beginning and end."""

_LARGEST_FILE = 256_000_000
"""Bytes of a film or picture."""


def checked(kind: Any, value: Any) -> Any:
    """A plain value in the form of ``kind``, which is a dataclass or what else pydantic knows.

    Raises:
        UnreadableError: it has another form; names the keys.
    """
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        odd = (".".join(map(str, one["loc"])) or "rows" for one in error.errors())
        raise UnreadableError(f"has no usable {', '.join(dict.fromkeys(odd))}") from error


def read_rows(path: Path, ranges: Ranges, within: Path) -> tuple[Rows, bool]:
    """A run's table, in which updates and steps rise; and whether its last row was torn off.

    Args:
        path: of a CSV file of numbers.
        ranges: columns that it must have, with a number between these ends in every row.
        within: a folder that it must lie in, also where it is a link.

    Raises:
        UnreadableError: no such table is in it.
    """
    # A row without a line's end was cut off by a kill, even if it looks whole.
    whole, _, torn = read_text(path).rpartition("\n")
    try:
        header, *body = csv.reader(io.StringIO(whole))
        table = np.array([[float(cell or "nan") for cell in row] for row in body])
        rows = dict(zip(header, table.T, strict=True))
    except (csv.Error, ValueError) as error:
        raise UnreadableError("is no table of numbers: a row is not whole, or none is") from error
    needed = {**dict.fromkeys((*_RISING, "wall_time"), (0.0, LARGEST)), **ranges}
    if missing := [name for name in {**needed, **_KNOWN} if name not in rows]:
        raise UnreadableError(f"is no table of a run: it has no column {', '.join(missing)}")
    for name, column in rows.items():
        low, high = needed.get(name) or _KNOWN.get(name) or (-LARGEST, LARGEST)
        known = column if name in needed else column[~np.isnan(column)]
        if not ((known >= low) & (known <= high)).all():
            raise UnreadableError(f"has {name} that is not between {low:g} and {high:g}")
    for name in _RISING:
        # Two processes that write one table leave rows twice, or out of order.
        if (np.diff(rows[name]) <= 0).any():
            raise UnreadableError(f"has {name}s that do not rise: more than one process wrote it")
    return rows, bool(torn)


def read_entries(path: Path, kind: Any, within: Path | None = None) -> tuple[Any, ...]:
    """The rows of a CSV file, each in the form of a dataclass whose fields are its columns.

    Raises:
        UnreadableError: no such table, or a row that makes no sense.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(path))))
    except csv.Error as error:
        raise UnreadableError(f"is no CSV file: {error}") from error
    return checked(Annotated[tuple[kind, ...], Field(min_length=1, max_length=10_000)], rows)


def check_media(path: Path, within: Path | None = None) -> Path:
    """The path of an MP4 or a PNG file that is there to its end.

    Raises:
        UnreadableError: cut off, out of the folder ``within``, or something else.
    """
    what, marks = ("film", _FILM) if path.suffix == ".mp4" else ("picture", _PICTURE)
    data = read_bytes(path)
    if not all(mark in data for mark in marks):
        raise UnreadableError(f"is no {what}, or cut off")
    return path


_Name = Annotated[str, StringConstraints(pattern=r"^\w[\w -]{0,39}$")]
"""Of a task, a fact or a phase: figures and tables have room for it."""

_FEW = Field(max_length=100)
"""Facts or phases."""


@dataclass(frozen=True)
class TaskNote:
    """What the study needs of a task; a run writes it down when it is created."""

    name: _Name
    goal: _Name
    """The fact that says that the task is done."""
    columns: Annotated[tuple[_Name, ...], _FEW]
    """Names in ``metrics.csv`` and evaluations of what was true at an episode's end."""
    phases: Annotated[tuple[tuple[_Name, _Name], ...], _FEW]
    """Parts of the task in their order: name, and the fact that ends it."""


class _Manifest(BaseModel):
    task: TaskNote


UNKNOWN = TaskNote("", "success", ("success",), ())
"""Of a run whose manifest does not say."""


def task_of(manifest: Mapping[str, Any]) -> TaskNote:
    """What a manifest says of the task.

    Raises:
        UnreadableError: nothing, or nothing that can be used.
    """
    if manifest.get("task") is None:
        raise UnreadableError("says nothing of the task: its phases and cheats are not known")
    note: TaskNote = checked(_Manifest, manifest).task
    if not {"success", note.goal, *(fact for _, fact in note.phases)} <= {*note.columns}:
        raise UnreadableError("has no usable task.columns")
    return note


NONE, ALL = "none", "all"
"""Conditions of a stress test without a disturbance, and with all of them at once."""


@dataclass(frozen=True)
class Stressed:
    """Success under one axis of disturbance at one severity: a row of ``stress.csv``."""

    axis: Annotated[str, Field(max_length=60)]
    severity: Annotated[int, Field(ge=0, le=99)]
    episodes: Annotated[int, Field(gt=0, lt=10**9)]
    success: Annotated[float, Field(ge=0, le=1)]
