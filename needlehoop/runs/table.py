"""A table of a run: a CSV file that grows row by row, with a copy in memory."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from needlehoop.runs.files import csv_text, naming, set_aside, write_whole
from needlehoop.runs.reading import TABLE, UnreadableError, read_bytes


class Table:
    """A CSV file and its text in memory, from which a damaged file is restored.

    A row's first column is its ``update``.

    Args:
        text: what was written of it so far.
    """

    def __init__(self, path: Path, text: str = ""):
        self.path, self.text = path, text

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row, and see that it is on the disk; NaN and ``None`` become empty cells.

        A table keeps the columns that it began with.

        Raises:
            RuntimeError: the row lacks a column of the table's.
        """
        known = next(csv.reader(io.StringIO(self.text)), [])
        if not set(known) <= set(row):
            raise RuntimeError(f"{self.path}: columns {known}; the row has {list(row)}")
        row = {name: row[name] for name in known} if known else row
        added = _line(_cell(value) for value in row.values())
        added = added if known else _line(row) + added
        with naming(self.path), self.path.open("ab") as file:
            file.write(added.encode())
            file.flush()
            os.fsync(file.fileno())
        self.text += added

    def rows(self) -> list[dict[str, str]]:
        """Its rows as they were written, by column."""
        return [*csv.DictReader(io.StringIO(self.text))]

    def settle(self) -> str | None:
        """Bring the file to what was written so far.

        Later rows are cut off: they are made again. A file that differs otherwise is kept under
        a number, and replaced.

        Returns:
            What was wrong, in a line.
        """
        own = self.text.encode()
        try:
            found = read_bytes(self.path, len(own) + TABLE) if self.path.exists() else b""
        except UnreadableError:
            # A pipe in the file's place, say: it is set aside as well.
            found = None
        if found == own:
            return None
        if found is not None and found.startswith(own):
            if own:
                with naming(self.path):
                    os.truncate(self.path, len(own))
            else:
                self.path.unlink()
            return None
        kept = set_aside(self.path)
        write_whole(self.path, own)
        where = f"; what was there is kept as {kept.name}" if kept else ""
        return f"{self.path} was damaged, and is whole again{where}"


def _line(cells: Iterable[Any]) -> str:
    return csv_text(cells, [])


def _cell(value: Any) -> Any:
    """Numbers with nine digits, which bring a float32 back to the bit."""
    if isinstance(value, float):
        return "" if value != value else format(value, ".9g")
    return "" if value is None else value
