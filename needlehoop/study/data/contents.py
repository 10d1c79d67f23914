"""Checks and reads what a run's files hold: tables of numbers, films, pictures."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlehoop.runs.reading import TABLE, UnreadableError, read_bytes, read_text

_LARGEST = float(2**53)
"""No number of a run is larger: sums and axes would overflow."""

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_PICTURE = 64_000_000
"""Bytes of a picture, at most."""

_HEADER = 8
"""Bytes of an MP4 box's length and name."""
_BOXES = 1_000
"""Boxes of a film, at most; ours have four."""


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
    # A row without a line's end was cut off by a kill, even if it looks whole.
    whole, _, torn = read_text(path, TABLE, within).rpartition("\n")
    try:
        header, *body = [*csv.reader(io.StringIO(whole))] or [[]]
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
    table = np.array(good, dtype=float)
    if (large := np.nanmax(np.abs(table), axis=0, initial=0.0) > _LARGEST).any():
        raise UnreadableError(f"has {header[int(large.argmax())]} that is too large for a run's")
    problems = [f"row {', '.join(bad)} left out: not whole"] if bad else []
    if torn:
        problems.append("last row left out: torn off")
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


def check_film(path: Path) -> None:
    """Checks that an MP4 file's boxes fill it exactly, and that one of them is its index.

    Raises:
        UnreadableError: empty, cut off, or something else.
    """
    if not path.is_file():
        raise UnreadableError("is no plain file")
    size, at, found = path.stat().st_size, 0, []
    if not size:
        raise UnreadableError("is empty")
    with path.open("rb") as file:
        while at + _HEADER <= size and len(found) < _BOXES:
            file.seek(at)
            header = file.read(_HEADER)
            length = int.from_bytes(header[:4], "big")
            if length == 1:
                # Too long for four bytes: eight more hold it.
                length = int.from_bytes(file.read(8), "big")
            if length < _HEADER:
                break
            found.append(header[4:])
            at += length
    if at != size or b"moov" not in found:
        raise UnreadableError("is no film, or cut off")


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
