"""What a probe shows: tables of the ranking, the phases and the agreement; two figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, cycle

import numpy as np
from matplotlib.figure import Figure

from needlehoop.config.task_options import STANDARD, task_name
from needlehoop.probe.folder import ProbeResults
from needlehoop.probe.plan import CONSTANT, TRUTH
from needlehoop.probe.scores import Interval as Scored
from needlehoop.runs.shipped import CONF
from needlehoop.scene.cameras import View
from needlehoop.study.data import paper
from needlehoop.study.data.paper import LISTS
from needlehoop.study.render.style import COLOURS, DASHES, FAINT, INK, new_figure
from needlehoop.study.render.table import Cell, Column, Estimated, Table
from needlehoop.study.stats.agreement import agreement
from needlehoop.study.stats.statistics import Interval

PHASES_TABLE = "phases"
"""Name of the longest table."""

_BASELINES = {TRUTH: "true state", CONSTANT: "constant"}


def all_tables(results: ProbeResults) -> list[Table]:
    """Every table that has rows."""
    tables = [_ranking(results), _phases(results), _agreements(results)]
    return [table for table in tables if table.rows]


def _ranking(results: ProbeResults) -> Table:
    """Camera sets by score, then the baselines."""
    rows, asked = [], results.asked
    for name in (*results.ranked, *_BASELINES):
        score, place = results.scores[name], results.places.get(name)
        rows.append(
            (
                None if place is None else _place(*place),
                _BASELINES.get(name, name),
                score.value,
                _interval(score),
                *(
                    Estimated(error.value, _interval(error))
                    for error in (results.error(name, p, asked.needed[p]) for p in asked.phases)
                ),
                *results.by_seed[name],
            )
        )
    columns = (
        Column("place"),
        Column("cameras"),
        Column("score", form=".3f"),
        Column("95 %", form=".3f"),
        *(Column(phase, "mm", ".2f") for phase in asked.phases),
        *(Column(f"seed {seed}", form=".3f") for seed in range(results.seeds)),
    )
    note = (
        "Score: mean over phases of 1 - error / error of a constant. Camera sets whose intervals"
        " (over held-out episodes) overlap share a place."
    )
    title = "Cameras by what can be read off their images"
    return Table("ranking", title, columns, tuple(rows), note)


def _phases(results: ProbeResults) -> Table:
    """Every error of every camera set, phase by phase."""
    asked = results.asked
    rows = [
        (
            _BASELINES.get(name, name),
            phase,
            quantity,
            found.value,
            _interval(found),
            True if asked.needed[phase] == quantity else None,
        )
        for name in (*results.ranked, *_BASELINES)
        for phase in asked.phases
        for quantity in asked.names
        for found in (results.error(name, phase, quantity),)
    ]
    columns = (
        Column("cameras"), Column("phase"), Column("quantity"), Column("error", form=".3f"),
        Column("95 %", form=".3f"), Column("needed"),
    )  # fmt: skip
    note = f"Errors in mm; of {asked.fact}, the share of frames in which it is wrong."
    return Table(PHASES_TABLE, "Errors by phase", columns, tuple(rows), note)


def _agreements(results: ProbeResults) -> Table:
    """The probe against the paper's measurements and its VLM, and against itself."""
    # The paper's task is the one that is chosen where none is named.
    rows = _published(results) if results.asked.task == task_name(STANDARD, [CONF]) else []
    for one, two in combinations(range(results.seeds), 2):
        sides = [{name: results.by_seed[name][s] for name in results.ranked} for s in (one, two)]
        if len(results.ranked) > 1:
            rows.append((f"seed {one}", f"seed {two}", *_said(*sides)))
    columns = (
        Column("list"), Column("against"), Column("n"), Column("tau-b", form=".2f"),
        Column("p", form=".2f"), Column("rho", form=".2f"), Column("best hit"),
        Column("worst hit"), Column("regret", form=".2f"),
    )  # fmt: skip
    note = (
        "The probe's order predicts the other one. p by permutation, two-sided; regret: by how much"
        " the probe's first choice falls short of the best there, in that side's unit."
    )
    kept = tuple(row for row in rows if row)
    return Table("agreement", "Agreement of the probe with other rankings", columns, kept, note)


def _published(results: ProbeResults) -> list[tuple[Cell, ...]]:
    measured, published = paper.measured(), paper.lists()
    rows = [
        _row(LISTS[name], "the paper's measured", {one: measured[one] for one in members}, results)
        for name, members in published.items()
    ]
    rows.append(_row("all", "the paper's measured", measured, results))
    said = zip(paper.answers().rankings, published, strict=True)
    for ranking, name in said:
        predicted = {cameras: -place for cameras, place in ranking.places.items()}
        rows.append(_row(LISTS[name], "the paper's VLM", predicted, results))
    return rows


def _row(
    name: str, against: str, measured: Mapping[str, float], results: ProbeResults
) -> tuple[Cell, ...]:
    """Nothing where the probe has not seen all of the list."""
    if not set(measured) <= set(results.ranked):
        return ()
    scores = {cameras: results.scores[cameras].value for cameras in measured}
    return (name, against, *_said(scores, measured))


def _said(predicted: Mapping[str, float], measured: Mapping[str, float]) -> tuple[Cell, ...]:
    found = agreement(predicted, measured)
    return (
        *(found.n, found.tau, found.tau_p, found.rho),
        *(found.top_hit, found.bottom_hit, found.regret),
    )


def _place(best: int, worst: int) -> Cell:
    return best if best == worst else Interval(best, worst)


def _interval(found: Scored) -> Interval:
    return Interval(found.low, found.high)


_ROW = 4.2
"""Height of a row, mm."""

_MARKS = ("o", "s", "^", "D", "v")


def ranking_figure(results: ProbeResults) -> Figure:
    """Scores with intervals, and beside them the errors in each phase."""
    names, needed = results.ranked, results.asked.needed
    figure, grid = new_figure(24 + _ROW * len(names), 1, 2, sharey=True)
    left, right = grid[0]
    for y, name in enumerate(names):
        found = results.scores[name]
        left.plot([found.low, found.high], [y, y], color=COLOURS[0], linewidth=1.6)
        left.plot(found.value, y, "o", color=COLOURS[0], markersize=3)
    left.set_yticks(range(len(names)), names)
    left.set_ylim(len(names) - 0.4, -0.6)
    left.tick_params(axis="y", length=0)
    left.grid(axis="both", linewidth=0.3)
    left.set_xlabel("score (1: no error)")
    looks = cycle(zip(COLOURS[1:], _MARKS, strict=False))
    for (phase, quantity), (colour, mark) in zip(needed.items(), looks, strict=False):
        values = [results.error(name, phase, quantity).value for name in names]
        right.plot(values, range(len(names)), mark, color=colour, markersize=3.2, label=phase)
        floor = results.error(TRUTH, phase, quantity).value
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
    axes.set_xlabel("azimuth, degrees (0: in front, 90: left)")
    axes.set_ylabel("elevation, degrees")
    bar = figure.colorbar(image, ax=axes, pad=0.02)
    bar.set_label(what)
    bar.outline.set_edgecolor(FAINT)
    return figure


def _edges(centres: Sequence[float]) -> np.ndarray:
    """Borders of cells around rising centres."""
    inner = (np.asarray(centres[:-1], dtype=float) + np.asarray(centres[1:], dtype=float)) / 2
    return np.array([2 * centres[0] - inner[0], *inner, 2 * centres[-1] - inner[-1]])
