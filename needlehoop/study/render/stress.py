"""The figure of disturbances: success over severity, axis by axis."""

from __future__ import annotations

from matplotlib.figure import Figure

from needlehoop.study.render.curves import MissingDataError
from needlehoop.study.render.style import COLOURS, DASHES, FAINT, WIDTH, new_figure, short
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.stress import robustness

_COSTS = 0.05
"""Share of the success that an axis must cost some camera set to be drawn."""

_COLUMNS, _MOST_SETS = 4, 7


def stress_figure(findings: StudyFindings) -> Figure:
    """A panel for each axis that costs some camera set anything, a line for each set.

    Raises:
        MissingDataError: no run was stressed.
    """
    found = robustness(findings)
    if not found:
        raise MissingDataError("no stress test; make one with: needlehoop stress <run>")
    count = min(len(found), _MOST_SETS)
    # From the best to the worst, evenly.
    shown = [found[round(i * (len(found) - 1) / max(1, count - 1))] for i in range(count)]
    worst: dict[str, float] = {}
    for one in shown:
        for (axis, severity), rate in one.success.items():
            if severity:
                lost = one.undisturbed.value - rate.value
                worst[axis] = max(worst.get(axis, 0.0), lost)
    axes = [axis for axis in worst if worst[axis] >= _COSTS] or list(worst)[:1]
    # All at once is of one severity: it is in the table.
    axes = sorted((axis for axis in axes if "." in axis), key=lambda axis: -worst[axis])
    if not axes:
        raise MissingDataError("no axis of its own in the stress test")
    rows = -(-len(axes) // _COLUMNS)
    figure, grid = new_figure(
        18 + 22 * rows + 3 * len(shown), rows, _COLUMNS, sharex=True, sharey=True
    )
    figure.set_figwidth(2 * WIDTH)
    for place, panel in enumerate(grid.flat):
        if place >= len(axes):
            panel.set_visible(False)
            continue
        axis = axes[place]
        panel.set_title(axis, loc="left", fontsize=6.5)
        for number, one in enumerate(shown):
            at = sorted(s for name, s in one.success if name == axis)
            values = [one.undisturbed.value, *(one.success[axis, s].value for s in at)]
            panel.plot(
                [0, *at], values, DASHES[number // len(COLOURS)], marker="o", markersize=2,
                color=COLOURS[number % len(COLOURS)], clip_on=False,
                label=short(one.name),
            )  # fmt: skip
        panel.set_xticks(sorted({0, *(s for one in shown for _, s in one.success)}))
        panel.set_ylim(0, 1)
        panel.set_yticks([0, 0.5, 1], ["0", "50 %", "100 %"])
        panel.grid(axis="y", color=FAINT, alpha=0.3, linewidth=0.4)
    figure.supxlabel("severity (0: undisturbed)", fontsize=7)
    figure.supylabel("success", fontsize=7)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(3, len(labels)), frameon=False,
        fontsize=6.5,
    )  # fmt: skip
    return figure
