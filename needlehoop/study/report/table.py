"""A table of text, and the three ways to write it down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from needlehoop.runs.files import csv_text

_LATEX: Mapping[int, str] = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "$": r"\$",
        "&": r"\&",
        "#": r"\#",
        "%": r"\%",
        "_": r"\_",
        "^": r"\textasciicircum{}",
        "~": r"\textasciitilde{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "\n": " ",
    }
)
_MARKDOWN: Mapping[int, str] = str.maketrans(
    {mark: f"\\{mark}" for mark in "\\`*_|<>[]"} | {"\n": " "}
)


@dataclass(frozen=True)
class Table:
    """Cells as text, all rows as long as the header."""

    name: str
    """Of its files."""
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def csv(self) -> str:
        """The cells alone, as they are."""
        return csv_text(self.header, self.rows)

    def text(self) -> str:
        """Aligned columns for a terminal, under the title."""
        lines = [self.header, *self.rows]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.header))]
        body = [
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        ]
        return "\n".join((self.title, *body, *([self.note] if self.note else []), ""))

    def markdown(self) -> str:
        """A table of GitHub's Markdown, under its title."""
        lines = [self.header, ("---",) * len(self.header), *self.rows]
        escaped = [
            line if i == 1 else tuple(cell.translate(_MARKDOWN) for cell in line)
            for i, line in enumerate(lines)
        ]
        body = "\n".join(f"| {' | '.join(line)} |" for line in escaped)
        note = f"\n\n{self.note.translate(_MARKDOWN)}" if self.note else ""
        return f"**{self.title.translate(_MARKDOWN)}**\n\n{body}{note}\n"

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
                *map(line, self.rows),
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
