"""What a probe shows: tables of the ranking, the phases and the agreement; two figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations, cycle

import numpy as np
from matplotlib.figure import Figure

from needlehoop.probe.frames import Quantities
from needlehoop.probe.plan import CONSTANT, TRUTH, Grid
from needlehoop.probe.scores import ProbeResults
from needlehoop.scene.cameras import View
from needlehoop.study.data import paper
from needlehoop.study.data.paper import LISTS
from needlehoop.study.render.style import COLOURS, DASHES, FAINT, INK, new_figure
from needlehoop.study.render.table import Table, written
from needlehoop.study.report.tables import agreed
from needlehoop.study.stats.agreement import agreement
from needlehoop.study.stats.predictions import PAPERS_MEASURED, said
from needlehoop.study.stats.statistics import Estimated

_BASELINES = {TRUTH: "true state", CONSTANT: "constant"}


def all_tables(results: ProbeResults) -> list[Table]:
    """Those that have rows."""
    tables = [_ranking(results), _phases(results), _agreements(results)]
    return [table for table in tables if not table.rows.empty]


def _ranking(results: ProbeResults) -> Table:
    """Camera sets by score, then the baselines."""
    asked = results.asked
    rows = []
    for name in (*results.ranked, *_BASELINES):
        row = {
            "place": _place(*results.places[name]) if name in results.places else "",
            "cameras": _BASELINES.get(name, name),
            **_estimated("score", results.score(name)),
        }
        for phase in asked.phases:
            row[f"{phase}, mm"] = written(results.error(name, phase, asked.needed[phase]))
        for seed, score in enumerate(results.scores_by_seed(name)):
            row[f"seed {seed}"] = written(score, ".3f")
        rows.append(row)
    note = (
        "Score: mean over phases of 1 - error / error of a constant. Camera sets whose intervals"
        " (over held-out episodes) overlap share a place."
    )
    return Table.of("ranking", "Cameras by what can be read off their images", rows, note)


def _estimated(name: str, found: Estimated) -> dict[str, str]:
    return {name: written(found.value, ".3f"), "95 %": written(found.interval, ".3f")}


def _phases(results: ProbeResults) -> Table:
    """Every error of every camera set, phase by phase."""
    asked = results.asked
    rows = [
        {
            "cameras": _BASELINES.get(name, name),
            "phase": phase,
            "quantity": quantity,
            **_estimated("error", results.error(name, phase, quantity)),
            "needed": "yes" if asked.needed[phase] == quantity else "",
        }
        for name in (*results.ranked, *_BASELINES)
        for phase in asked.phases
        for quantity in asked.names
    ]
    note = f"Errors in mm; of {asked.fact}, the share of frames in which it is wrong."
    return Table.of("phases", "Errors by phase", rows, note)


def _agreements(results: ProbeResults) -> Table:
    """The probe against the paper's measurements and its VLM, and against itself."""
    scores = {name: results.score(name).value for name in results.ranked}
    sides: list[tuple[str, str, Mapping[str, float], Mapping[str, float]]] = [
        (name, against, {one: scores[one] for one in theirs}, theirs)
        for name, against, theirs in _published(results.asked)
        # Nothing where the probe has not seen all of the list.
        if set(theirs) <= set(scores)
    ]
    for one, two in combinations(range(results.seeds) if len(scores) > 1 else (), 2):
        own = {name: results.scores_by_seed(name) for name in scores}
        first, second = ({name: own[name][seed] for name in own} for seed in (one, two))
        sides.append((f"seed {one}", f"seed {two}", first, second))
    rows = []
    for name, against, predicted, theirs in sides:
        found = agreement(predicted, theirs)
        sizes = {"list": name, "against": against, "n": str(found.n)}
        rows.append(sizes | agreed(found))
    note = (
        "The probe's order predicts the other one. p by permutation, two-sided; regret: by how much"
        " the probe's first choice falls short of the best there, in that side's unit."
    )
    return Table.of("agreement", "Agreement of the probe with other rankings", rows, note)


def _published(asked: Quantities) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """The paper's lists with what it measured, then what its VLM said; of its own task alone."""
    if asked.task != paper.task():
        return
    measured, published = paper.measured(), paper.lists()
    for name, members in published.items():
        yield LISTS[name], PAPERS_MEASURED, {one: measured[one] for one in members}
    yield "all", PAPERS_MEASURED, measured
    told = said(paper.SOURCE, paper.answers())
    for name, scores in zip(published, told.lists.values(), strict=True):
        yield LISTS[name], told.who, scores


def _place(best: int, worst: int) -> str:
    return f"{best}" if best == worst else f"{best} to {worst}"


_MARKS = ("o", "s", "^", "D", "v")


def ranking_figure(results: ProbeResults) -> Figure:
    """Scores with intervals, and beside them the errors in each phase."""
    names, needed = results.ranked, results.asked.needed
    # 4.2 mm for each camera set.
    figure, grid = new_figure(24 + 4.2 * len(names), 1, 2, sharey=True)
    left, right = grid[0]
    for y, name in enumerate(names):
        found = results.score(name)
        assert found.interval is not None
        ends = [found.interval.low, found.interval.high]
        left.plot(ends, [y, y], color=COLOURS[0], linewidth=1.6)
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


def view_map(results: ProbeResults, grid: Grid, standing: Mapping[str, View]) -> Figure:
    """Scores over azimuth and elevation; ``standing``, which agents can choose, are marked."""
    azimuths, elevations = grid.azimuths, grid.elevations
    scores = [results.score(f"{grid.rendering}_{name}").value for name in grid.views(standing)]
    values = np.array(scores).reshape(len(elevations), len(azimuths))
    figure, [[axes]] = new_figure(62)
    image = axes.pcolormesh(
        azimuths, elevations, values, cmap="cividis", linewidth=0, shading="nearest"
    )
    middle = (values.min() + values.max()) / 2
    for e, row in zip(elevations, values, strict=True):
        for a, value in zip(azimuths, row, strict=True):
            ink = INK if value > middle else "white"
            axes.text(a, e, f"{value:.2f}", ha="center", va="center", fontsize=5.5, color=ink)
    for name, view in standing.items():
        if view.azimuth is None or view.body != standing[grid.like].body:
            continue
        axes.plot(view.azimuth, view.elevation, "D", markersize=4, markerfacecolor="none",
                  markeredgecolor=COLOURS[1], clip_on=False)  # fmt: skip
        axes.annotate(name, (view.azimuth, view.elevation), (3, 5), textcoords="offset points",
                      fontsize=6.5, color=COLOURS[1], fontweight="bold")  # fmt: skip
    axes.set_xticks(azimuths)
    axes.set_yticks(elevations)
    axes.set_xlabel("azimuth, degrees (0: in front, 90: left)")
    axes.set_ylabel("elevation, degrees")
    bar = figure.colorbar(image, ax=axes, pad=0.02)
    bar.set_label(f"score of one {grid.rendering} camera")
    bar.outline.set_edgecolor(FAINT)
    return figure
