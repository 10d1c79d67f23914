"""Checks and reads what files hold: tables, films, pictures, and what a manifest says of a task."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field, StringConstraints, TypeAdapter, ValidationError

from needlehoop.runs.reading import TABLE, UnreadableError, read_bytes, read_text

_LARGEST = float(2**53)
"""No number of a run is larger: sums and axes would overflow."""

_RISING = ("update", "step")

RETURN_RANGE = (-1e9, 1e9)
_KNOWN = {"return": RETURN_RANGE, "success": (0.0, 1.0)}
"""Columns of each table of a run; empty in a row in which no episode ended."""

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_PICTURE = 64_000_000
"""Bytes of a picture, at most."""

_FILM = 256_000_000
"""The same of a film."""


def checked(kind: Any, value: Any) -> Any:
    """A plain value in the form of ``kind``, which is a dataclass or what else pydantic knows.

    Raises:
        UnreadableError: it has another form; names the keys.
    """
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        odd = (".".join(map(str, one["loc"])) for one in error.errors())
        raise UnreadableError(f"has no usable {', '.join(dict.fromkeys(odd))}") from error


@dataclass(frozen=True)
class Rows:
    """A table of numbers, ``(n,)`` for each column; NaN where a cell is empty."""

    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]


def read_rows(
    path: Path, ranges: Mapping[str, tuple[float, float]], within: Path
) -> tuple[Rows, list[str]]:
    """The whole rows of a run's table, in which updates and steps rise; what is wrong with others.

    Args:
        path: of a CSV file of numbers.
        ranges: columns that it must have, with a number between these ends in every row.
        within: a folder that it must lie in, also where it is a link.

    Raises:
        UnreadableError: no such table is in it.
    """
    # A row without a line's end was cut off by a kill, even if it looks whole.
    whole, _, torn = read_text(path, TABLE, within).rpartition("\n")
    try:
        header, *body = [*csv.reader(io.StringIO(whole))] or [[]]
    except csv.Error as error:
        raise UnreadableError(f"is no CSV file: {error}") from error
    needed = (*_RISING, "wall_time", *ranges)
    missing = [n for n in dict.fromkeys((*needed, *_KNOWN)) if n not in header]
    if missing:
        raise UnreadableError(f"is no table of a run: it has no column {', '.join(missing)}")
    if len(set(header)) < len(header):
        raise UnreadableError("names a column twice")
    good: list[list[float]] = []
    bad: list[str] = []
    for number, cells in enumerate(body, start=2):
        row = _numbers(cells, len(header))
        if row is None or any(math.isnan(row[header.index(name)]) for name in needed):
            bad.append(str(number))
        else:
            good.append(row)
    if not good:
        raise UnreadableError("has no whole row")
    table = np.array(good, dtype=float)
    if (large := np.nanmax(np.abs(table), axis=0, initial=0.0) > _LARGEST).any():
        raise UnreadableError(f"has {header[int(large.argmax())]} that is too large for a run's")
    rows = Rows({name: table[:, i] for i, name in enumerate(header)})
    for name in _RISING:
        # Two processes that write one table leave rows twice, or out of order.
        falls = np.flatnonzero(np.diff(rows[name], prepend=-1.0) <= 0)
        if len(falls):
            raise UnreadableError(
                f"has {name}s that do not rise, {len(falls)} times, first at"
                f" {rows[name][falls[0]]:g}: more than one process wrote it"
            )
    for name, (low, high) in {**_KNOWN, **ranges}.items():
        if ((rows[name] < low) | (rows[name] > high)).any():
            raise UnreadableError(f"has {name} that are not between {low:g} and {high:g}")
    problems = [f"row {', '.join(bad)} left out: not whole"] if bad else []
    if torn:
        problems.append("last row left out: torn off")
    return rows, problems


def _numbers(cells: list[str], width: int) -> list[float] | None:
    """A row's numbers; ``None`` for a row that is too short, too long or not numbers."""
    if len(cells) != width:
        return None
    try:
        values = [float(cell) if cell else math.nan for cell in cells]
    except ValueError:
        return None
    return None if any(map(math.isinf, values)) else values


def check_film(path: Path, within: Path) -> Path:
    """The path of an MP4 file that lies in a folder and has the index that is written last.

    Raises:
        UnreadableError: empty, cut off, elsewhere, or something else.
    """
    data = read_bytes(path, _FILM, within)
    if not data:
        raise UnreadableError("is empty")
    if b"moov" not in data:
        raise UnreadableError("is no film, or cut off")
    return path


def check_picture(path: Path) -> None:
    """Checks that a PNG file begins and ends as one.

    Raises:
        UnreadableError: empty, cut off, something else, or it cannot be opened.
    """
    data = read_bytes(path, _PICTURE)
    if not data:
        raise UnreadableError("is empty")
    if not (data.startswith(_PNG_START) and data.endswith(_PNG_END)):
        raise UnreadableError("is no picture, or cut off")


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
    told = {"success", note.goal, *(fact for _, fact in note.phases)}
    if not told <= {*note.columns} or ("cheat" in note.columns) is not manifest["task"].get(
        "cheat"
    ):
        raise UnreadableError("has no usable task")
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


def read_stress(path: Path, within: Path) -> tuple[Stressed, ...]:
    """The rows of a ``stress.csv``.

    Raises:
        UnreadableError: no such table, or a row that makes no sense.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(path, TABLE, within))))
    except csv.Error as error:
        raise UnreadableError(f"is no CSV file: {error}") from error
    return checked(Annotated[tuple[Stressed, ...], Field(min_length=1, max_length=10_000)], rows)
