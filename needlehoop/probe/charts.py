"""The probe's figures: the ranking, and the map of a grid of cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from needlehoop.probe.findings import Findings
from needlehoop.probe.frames import PHASES
from needlehoop.probe.plan import TRUTH
from needlehoop.probe.scores import NEEDED
from needlehoop.scene.cameras import View
from needlehoop.study.data.combinations import label
from needlehoop.study.render.style import COLOURS, DASHES, FAINT, INK, new_figure

_ROW = 4.2
"""Height of a row, mm."""

_MARKS = ("o", "s", "^")


def ranking(findings: Findings) -> Figure:
    """Scores with intervals, and beside them what is behind: errors phase by phase."""
    names = findings.ranked
    figure, grid = new_figure(24 + _ROW * len(names), 1, 2, sharey=True)
    left, right = grid[0]
    for y, name in enumerate(names):
        found = findings.scores[name]
        left.plot([found.low, found.high], [y, y], color=COLOURS[0], linewidth=1.6)
        left.plot(found.value, y, "o", color=COLOURS[0], markersize=3)
    left.set_yticks(range(len(names)), [label(name) for name in names])
    left.set_ylim(len(names) - 0.4, -0.6)
    left.tick_params(axis="y", length=0)
    left.grid(axis="both", linewidth=0.3)
    left.set_xlabel("score (1: no error)")
    for phase, colour, mark in zip(PHASES, COLOURS[1:], _MARKS, strict=False):
        values = [findings.error(name, phase, NEEDED[phase]).value for name in names]
        right.plot(values, range(len(names)), mark, color=colour, markersize=3.2, label=phase)
        floor = findings.error(TRUTH, phase, NEEDED[phase]).value
        right.axvline(floor, color=colour, linewidth=0.6, linestyle=DASHES[3])
    right.tick_params(axis="y", length=0)
    right.grid(axis="both", linewidth=0.3)
    right.set_xlim(left=0)
    right.set_xlabel("error, mm\n(dotted: true state)")
    figure.legend(loc="outside upper right", ncols=3, frameon=False, fontsize=6.5,
                  handletextpad=0.1, columnspacing=0.8)  # fmt: skip
    return figure


def view_map(
    scores: Mapping[tuple[float, float], float],
    azimuths: Sequence[float],
    elevations: Sequence[float],
    standing: Mapping[str, View],
    what: str,
) -> Figure:
    """Scores over azimuth and elevation, with the named views marked.

    Args:
        scores: by azimuth and elevation, degrees.
        azimuths: columns, rising.
        elevations: rows, rising.
        standing: the views that agents can choose.
        what: the colour bar's label.
    """
    values = np.array([[scores[a, e] for a in azimuths] for e in elevations])
    figure, grid = new_figure(62)
    axes = grid[0, 0]
    image = axes.pcolormesh(
        _edges(azimuths), _edges(elevations), values, cmap="cividis", linewidth=0
    )
    middle = (values.min() + values.max()) / 2
    for e, row in zip(elevations, values, strict=True):
        for a, value in zip(azimuths, row, strict=True):
            ink = INK if value > middle else "white"
            axes.text(a, e, f"{value:.2f}", ha="center", va="center", fontsize=5.5, color=ink)
    for name, view in standing.items():
        axes.plot(view.azimuth, view.elevation, "D", markersize=4, markerfacecolor="none",
                  markeredgecolor=COLOURS[1], clip_on=False)  # fmt: skip
        axes.annotate(name, (view.azimuth, view.elevation), (3, 5), textcoords="offset points",
                      fontsize=6.5, color=COLOURS[1], fontweight="bold")  # fmt: skip
    axes.set_xticks(azimuths)
    axes.set_yticks(elevations)
    axes.set_xlabel("azimuth, degrees (0: in front of the hoop, 90: left)")
    axes.set_ylabel("elevation, degrees")
    bar = figure.colorbar(image, ax=axes, pad=0.02)
    bar.set_label(what)
    bar.outline.set_edgecolor(FAINT)
    return figure


def _edges(centres: Sequence[float]) -> np.ndarray:
    """Borders of cells around rising centres."""
    inner = (np.asarray(centres[:-1], dtype=float) + np.asarray(centres[1:], dtype=float)) / 2
    return np.array([2 * centres[0] - inner[0], *inner, 2 * centres[-1] - inner[-1]])
