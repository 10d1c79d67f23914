"""A figure of trainings: a row for each camera set, a dot for each training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlehoop.study.render.style import COLOURS, FAINT, new_figure


def of_hundred(axes: Axes, label: str = "threaded, of 100") -> None:
    """An axis for shares of 100, with lines to read them by."""
    axes.set_xlim(-2, 102)
    axes.set_xlabel(label)
    axes.grid(axis="x", color=FAINT, alpha=0.25, linewidth=0.5)


def trainings_figure(
    rows: Mapping[str, Mapping[str, Sequence[float]]], kinds: Sequence[str], height: float
) -> Figure:
    """Dots for the shares of each row's kinds, and a bar for their mean; the last row on top.

    Args:
        rows: shares from 0 to 1, by row and by kind.
        kinds: all of them, a colour each.
        height: of a row, mm.
    """
    figure, ((axes,),) = new_figure(height * len(rows) + 16)
    for row, groups in enumerate(rows.values()):
        for number, (kind, shares) in enumerate(groups.items()):
            points, colour = 100 * np.array(shares), COLOURS[kinds.index(kind)]
            place = row + 0.22 * ((len(groups) - 1) / 2 - number)
            axes.plot(points, [place] * len(points), "o", markersize=3, color=colour, alpha=0.6)
            axes.plot(points.mean(), place, "|", markersize=8, markeredgewidth=1.6, color=colour)
    axes.set_yticks(range(len(rows)), [*rows])
    of_hundred(axes, "threaded, of 100\n(dot: a training, bar: the mean)")
    for number, kind in enumerate(kinds):
        axes.plot([], [], "o", markersize=3, color=COLOURS[number], label=kind)
    above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
    axes.legend(**above, ncols=len(kinds), frameon=False, fontsize=6.5)
    return figure
