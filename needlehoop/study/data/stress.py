"""``stress.csv`` of a run: what disturbances cost it."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import NamedTuple

from needlehoop.runs.reading import TABLE, UnreadableError, read_text

NONE, ALL = "none", "all"
"""Conditions without a disturbance, and with all of them at once."""

_NEEDED = ("axis", "severity", "episodes", "success")
_MOST_ROWS = 10_000


class Stressed(NamedTuple):
    """Success under one axis of disturbance at one severity."""

    axis: str
    severity: int
    episodes: int
    success: float


def read_stress(path: Path, within: Path) -> tuple[Stressed, ...]:
    """The rows of a ``stress.csv``.

    Raises:
        UnreadableError: no such table, or a row that makes no sense.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(path, TABLE, within))))
    except csv.Error as error:
        raise UnreadableError(f"is no CSV file: {error}") from error
    if not rows or len(rows) > _MOST_ROWS:
        raise UnreadableError("has no rows" if not rows else "has too many rows")
    if missing := [name for name in _NEEDED if name not in rows[0]]:
        raise UnreadableError(f"is no stress test: it has no column {', '.join(missing)}")
    return tuple(_row(number, row) for number, row in enumerate(rows, start=2))


def _row(number: int, row: dict[str, str]) -> Stressed:
    try:
        axis, episodes = str(row["axis"]), int(row["episodes"])
        found = Stressed(axis, int(row["severity"]), episodes, float(row["success"]))
    except (TypeError, ValueError) as error:
        raise UnreadableError(f"has no numbers in row {number}") from error
    in_range = 0 <= found.success <= 1 and 0 <= found.severity <= 99
    if not (in_range and 0 < found.episodes < 10**9 and len(axis) < 60):
        raise UnreadableError(f"makes no sense in row {number}")
    return found
