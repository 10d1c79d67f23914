"""Number tables from CSV files that may be torn, empty or something else altogether."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlehoop.runs.reading import TABLE, UnreadableError, read_text


@dataclass(frozen=True)
class Rows:
    """A table of numbers, ``(n,)`` for each column; NaN where a cell is empty."""

    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> np.ndarray:
        """A column.

        Raises:
            ValueError: an unknown name; the message lists the valid ones.
        """
        if name not in self.columns:
            raise ValueError(f"column {name!r} is unknown; choose from {', '.join(self.columns)}")
        return self.columns[name]


def read_rows(
    path: Path, needed: Sequence[str], within: Path | None = None
) -> tuple[Rows, list[str]]:
    """The whole rows of a CSV file of numbers, and what was wrong with the others.

    Args:
        path: of the file.
        needed: columns that it must have, with a number in every row.
        within: a folder that it must lie in, also where it is a link.

    Raises:
        UnreadableError: no such table is in it.
    """
    # A row without its line's end was torn off by a kill, even if it looks whole.
    whole, _, torn = read_text(path, TABLE, within).rpartition("\n")
    lines = csv.reader(io.StringIO(whole))
    try:
        header, *body = list(lines) or [[]]
    except csv.Error as error:
        raise UnreadableError(f"is no CSV file: {error}") from error
    missing = [name for name in needed if name not in header]
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
    problems = [f"row {', '.join(bad)} left out: not whole"] if bad else []
    if torn:
        problems.append("last row left out: torn off")
    table = np.array(good, dtype=float)
    return Rows({name: table[:, i] for i, name in enumerate(header)}), problems


def _numbers(cells: list[str], width: int) -> list[float] | None:
    """A row's numbers; ``None`` for a row that is too short, too long or not numbers."""
    if len(cells) != width:
        return None
    try:
        values = [float(cell) if cell else math.nan for cell in cells]
    except ValueError:
        return None
    return None if any(map(math.isinf, values)) else values
