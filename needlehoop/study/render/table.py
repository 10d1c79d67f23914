"""Tables of text: how numbers are written, and the files that hold them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from needlehoop.study.stats.statistics import Estimated, Interval

Cell = float | str | Interval | Estimated | Sequence["Cell"] | None


def written(cell: Cell, form: str = ".2f", scale: float = 1.0) -> str:
    """A table's cell: a number with its interval, or several; empty where nothing is known.

    Args:
        form: as Python's ``format`` takes it.
        scale: from the cell's unit to the written one, such as 100 for percent.
    """
    match cell:
        case None:
            return ""
        case str():
            return cell
        case Interval(low, high, over_episodes):
            remark = " (over episodes)" if over_episodes else ""
            return f"{written(low, form, scale)} to {written(high, form, scale)}{remark}"
        case Estimated(value, interval):
            ends = f" ({written(interval, form, scale)})" if interval else ""
            return written(value, form, scale) + ends
        case float() | int():
            return "undefined" if math.isnan(cell) else f"{scale * cell:{form}}"
    return ", ".join(written(part, form, scale) for part in cell)


def percent(cell: Cell) -> str:
    """Shares in percent."""
    return written(cell, ".0f", 100.0)


def p_value(value: float | None) -> str:
    """Two digits, or one that is not 0."""
    return written(value, ".1g" if value is not None and value < 0.01 else ".2f")


@dataclass(frozen=True)
class Table:
    """A table of text under a title."""

    name: str
    """Of its files."""
    title: str
    rows: pd.DataFrame
    note: str = ""

    @classmethod
    def of(cls, name: str, title: str, rows: Sequence[dict[str, str]], note: str = "") -> Table:
        return cls(name, title, pd.DataFrame(rows, dtype=str), note)

    def text(self) -> str:
        """Aligned columns for a terminal, under the title."""
        body = self.rows.to_markdown(tablefmt="plain", index=False, disable_numparse=True)
        return f"{self.title}\n{body}\n{self.note}"

    def markdown(self) -> str:
        """The rows alone, as a table of Markdown."""
        lines = [[*self.rows], *self.rows.to_numpy().tolist()]
        head, *rows = (f"| {' | '.join(line)} |\n" for line in lines)
        return head + "|" + "---|" * self.rows.shape[1] + "\n" + "".join(rows)

    def write(self, folder: Path) -> list[Path]:
        """CSV and Markdown into a folder; without rows, what an earlier call wrote is removed."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"{self.name}.csv", folder / f"{self.name}.md"]
        if self.rows.empty:
            for path in paths:
                path.unlink(missing_ok=True)
            return []
        self.rows.to_csv(paths[0], index=False)
        paths[1].write_text(f"**{self.title}**\n\n{self.markdown()}\n{self.note}\n")
        return paths
