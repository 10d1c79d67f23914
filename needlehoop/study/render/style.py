"""How figures look: column width, colours that everyone can tell apart, files that repeat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

WIDTH = 85 / 25.4
"""A journal's column, inches."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's, less the yellow that white paper swallows."""

DASHES = ("-", "--", "-.", ":")
INK, FAINT = "#22262e", "#8a8f98"

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 7,
    "axes.titlesize": 7.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 7,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "figure.dpi": 100,
    "savefig.dpi": 300,
}


def styled() -> Any:
    """A context in which figures get the house's style."""
    return mpl.rc_context(_SETTINGS)


def new_figure(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Any, Any]:
    """A column-wide figure and its axes ``(rows, columns)``; ``height`` in mm."""
    figure = Figure(figsize=(WIDTH, height / 25.4), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def short(name: str) -> str:
    """A name for which a figure has room."""
    return name if len(name) <= 40 else f"{name[:39]}…"


def save(figure: Figure, stem: Path) -> Path:
    """Write a figure as PNG; returns its path."""
    # A name may have dots in it: its end would be taken for a suffix.
    png = stem.with_name(f"{stem.name}.png")
    png.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(png, metadata={"Software": None})
    return png
