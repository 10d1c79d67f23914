"""Tables: rows of numbers, and the one place that makes text of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from needlehoop.runs.files import csv_text
from needlehoop.study.stats.run import Measure
from needlehoop.study.stats.statistics import OVER_EPISODES, Estimated, Interval

_LATEX: Mapping[int, str] = str.maketrans(
    {mark: f"\\{mark}" for mark in "{}$&#%_"}
    | {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"}
    | {"<": r"\textless{}", ">": r"\textgreater{}", "\n": " "}
)
_MARKDOWN: Mapping[int, str] = str.maketrans(
    {mark: f"\\{mark}" for mark in "\\`*_|<>[]"} | {"\n": " "}
)


@dataclass(frozen=True)
class Of:
    """So many of so many, or a place among so many."""

    number: float
    of: int


Cell = float | str | bool | Interval | Estimated | Of | Sequence["Cell"] | None
"""Numbers are in the column's own unit before its ``scale``; ``None``: nothing is known; a text is
a name or a remark; several are written one after the other."""


@dataclass(frozen=True)
class Column:
    """What a column's numbers are, and how they are written."""

    name: str
    unit: str = ""
    form: str = "g"
    """As Python's ``format`` takes it; ``p``: two digits, or one that is not 0."""
    scale: float = 1.0
    """From a row's number to the written one: 100 for a share in percent."""

    @classmethod
    def share(cls, name: str) -> Column:
        """Shares, written in percent."""
        return cls(name, "%", ".0f", 100.0)

    @classmethod
    def of(cls, measure: Measure) -> Column:
        form = f".{measure.digits}f"
        return cls(measure.name, measure.unit, form, 100.0 if measure.unit == "%" else 1.0)

    @property
    def heading(self) -> str:
        return f"{self.name}, {self.unit}" if self.unit else self.name

    def text(self, cell: Cell) -> str:
        """A cell as it is written."""
        match cell:
            case None:
                return ""
            case str():
                return cell
            case bool():
                return "yes" if cell else "no"
            case Interval(low, high, over):
                remark = f" ({over})" if over == OVER_EPISODES else ""
                return f"{self._number(low)} to {self._number(high)}{remark}"
            case Estimated(value, interval):
                ends = f" ({self.text(interval)})" if interval else ""
                return self._number(value) + ends
            case Of(number, of):
                return f"{self._number(number)} of {of}"
            case float() | int():
                return self._number(cell)
        return ", ".join(map(self.text, cell))

    def _number(self, value: float) -> str:
        if math.isnan(value):
            return "undefined"
        if self.form == "p":
            return f"{value:.1g}" if value < 0.01 else f"{value:.2f}"
        return f"{self.scale * value:{self.form}}"


Row = dict[Column, Cell]
"""Cells by column."""


@dataclass(frozen=True)
class Table:
    """Rows of cells, each as long as there are columns."""

    name: str
    """Of its files."""
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    @classmethod
    def of(cls, name: str, title: str, rows: Sequence[Row], note: str = "") -> Table:
        """Rows that all have the same columns; without rows there are none."""
        columns = tuple(rows[0]) if rows else ()
        return cls(name, title, columns, tuple(tuple(row.values()) for row in rows), note)

    @property
    def header(self) -> tuple[str, ...]:
        return tuple(column.heading for column in self.columns)

    @property
    def texts(self) -> list[tuple[str, ...]]:
        """The rows as they are written."""
        return [
            tuple(column.text(cell) for column, cell in zip(self.columns, row, strict=True))
            for row in self.rows
        ]

    def csv(self) -> str:
        """Headings and rows alone."""
        return csv_text(self.header, self.texts)

    def text(self) -> str:
        """Aligned columns for a terminal, under the title."""
        lines = [self.header, *self.texts]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        body = ("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)
        return "\n".join((self.title, *body, *([self.note] if self.note else []), ""))

    def markdown(self) -> str:
        """A table of GitHub's Markdown, under its title."""
        head, *rows = (
            f"| {' | '.join(cell.translate(_MARKDOWN) for cell in line)} |\n"
            for line in (self.header, *self.texts)
        )
        rule = f"| {' | '.join(['---'] * len(self.header))} |\n"
        note = f"\n{self.note.translate(_MARKDOWN)}\n" if self.note else ""
        title = self.title.translate(_MARKDOWN)
        return f"**{title}**\n\n{head}{rule}{''.join(rows)}{note}"

    def latex(self) -> str:
        """A floating table; needs the package ``booktabs``."""

        def line(cells: tuple[str, ...]) -> str:
            return " & ".join(cell.translate(_LATEX) for cell in cells) + r" \\"

        caption = " ".join(part for part in (f"{self.title}.", self.note) if part)
        return "\n".join(
            (
                r"\begin{table}",
                rf"\caption{{{caption.translate(_LATEX)}}}",
                rf"\label{{tab:{self.name.replace('_', '-')}}}",
                rf"\begin{{tabular}}{{{'l' * len(self.header)}}}",
                r"\toprule",
                line(self.header),
                r"\midrule",
                *map(line, self.texts),
                r"\bottomrule",
                r"\end{tabular}",
                r"\end{table}",
                "",
            )
        )

    def write(self, folder: Path) -> list[Path]:
        """CSV, Markdown and LaTeX into a folder, which is made where missing.

        Without rows nothing is written, and what an earlier call wrote is removed.
        """
        folder.mkdir(parents=True, exist_ok=True)
        written = []
        for suffix, text in (("csv", self.csv), ("md", self.markdown), ("tex", self.latex)):
            path = folder / f"{self.name}.{suffix}"
            if not self.rows:
                path.unlink(missing_ok=True)
                continue
            path.write_text(text(), encoding="utf-8")
            written.append(path)
        return written
