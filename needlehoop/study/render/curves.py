"""Learning curves: the paper's Figures 6 and 7 over a study's own runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from needlehoop.study.data import paper
from needlehoop.study.data.paper import LISTS, reward_label, reward_order
from needlehoop.study.data.records import Record
from needlehoop.study.render.style import COLOURS, DASHES, apart, in_percent, new_figure, short
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.run import evaluations, grid_of, has_curve, smooth
from needlehoop.study.stats.statistics import band

_PANEL = 7
"""Curves in a panel, at most: one for each colour."""

LineEnd = tuple[str, float, float, str]
"""A line's name, where it ends in millions of steps and in y, and its colour."""

Lines = Sequence[tuple[str, Sequence[Record], int]]
"""What a panel shows: name, runs and number of the colour of each line."""

Curve = Callable[[Record, np.ndarray], np.ndarray]
"""A run's values on a grid of steps, NaN where it has none."""


class MissingDataError(ValueError):
    """A study lacks what a figure shows; the message says what."""


def learning_curves(findings: StudyFindings) -> Figure:
    """Return over training for each camera set.

    Few share a panel; many are parted into the paper's three lists, if it is of its task, and the
    rest.

    Raises:
        MissingDataError: no run has a learning curve.
    """
    drawn = {one.cameras: one for one in findings.ranked if any(map(has_curve, one.runs))}
    if not drawn:
        raise MissingDataError("no learning curves")
    panels = [("", list(drawn.values()))]
    if len(drawn) > _PANEL:
        panels = _in_lists(drawn, paper.lists() if findings.is_papers else {})
    figure, grid = new_figure(6 + 46 * len(panels), len(panels), sharex=True)
    colours = _colours([[result.cameras for result in own] for _, own in panels])
    shown = [
        (title, [(short(r.cameras), r.runs, colours[r.cameras]) for r in own])
        for title, own in panels
    ]
    ends = draw_panels(grid[:, 0], shown, partial(smooth, column="return"), "return in training")
    name_ends(figure, grid[:, 0], ends)
    return figure


def _in_lists(
    drawn: Mapping[str, Result], lists: Mapping[str, Sequence[str]]
) -> list[tuple[str, list[Result]]]:
    """Camera sets by the paper's lists; one that is in two of them is shown in both."""
    panels = [
        (LISTS[name], [drawn[cameras] for cameras in drawn if cameras in members])
        for name, members in lists.items()
    ]
    listed = {cameras for members in lists.values() for cameras in members}
    rest = [drawn[cameras] for cameras in drawn if cameras not in listed]
    others = "Others" if any(own for _, own in panels) else ""
    panels += [(others, rest[i : i + _PANEL]) for i in range(0, len(rest), _PANEL)]
    return [(title, own) for title, own in panels if own]


def _colours(panels: Sequence[Sequence[str]]) -> dict[str, int]:
    """A number for each name: the same in all panels, and no other name's in any of its own."""
    found: dict[str, int] = {}
    for names in panels:
        taken = {found[name] for name in names if name in found}
        free = (number for number in count() if number not in taken)
        found |= {name: next(free) for name in names if name not in found}
    return found


def reward_comparison(findings: StudyFindings) -> Figure:
    """What training brings by reward, for each camera set that was trained with several.

    Beside the returns stands how often training's sampled actions succeed, and how often the mean
    action does in evaluations: it can stop short where noise still gets there.

    Raises:
        MissingDataError: no camera set was trained with two rewards.
    """
    rivals = {
        result.cameras: [
            one
            for one in sorted(findings.results, key=lambda one: reward_order(one.reward))
            if one.cameras == result.cameras and any(map(has_curve, one.runs))
        ]
        for result in findings.ranked
    }
    panels = {cameras: own for cameras, own in rivals.items() if len(own) > 1}
    if not panels:
        raise MissingDataError("no camera set with learning curves for two rewards")
    figure, grid = new_figure(17 + 36 * len(panels), len(panels), 3, sharex=True)
    # A reward keeps its colour from panel to panel.
    colours = sorted({one.reward for own in panels.values() for one in own}, key=reward_order)
    lines: list[Lines] = [
        [(one.reward, one.runs, colours.index(one.reward)) for one in own]
        for own in panels.values()
    ]
    titled = [*zip(map(short, panels), lines, strict=True)]
    untitled = [("", own) for own in lines]
    draw_panels(grid[:, 0], titled, partial(smooth, column="return"), "return in its own points")
    draw_panels(grid[:, 1], untitled, partial(smooth, column="success"), findings.goal)
    draw_panels(grid[:, 2], untitled, _evaluated, "")
    for axes in grid[:, 1:].flat:
        in_percent(axes, room=0.05)
    for axes in grid[:, 2]:
        axes.tick_params(labelleft=False)
    for axes, said in zip(grid[0, 1:], ("in training", "in evaluations"), strict=True):
        axes.set_title(said, fontweight="normal", fontsize=6.5)
    grid[-1, 1].set_xlabel("training steps, millions")
    # Each reward has one colour in all panels, so one legend is enough.
    drawn = [
        Line2D([], [], color=colour, linestyle=dash, linewidth=1.2)
        for colour, dash in map(_stroke, range(len(colours)))
    ]
    names = [short(reward_label(reward)) for reward in colours]
    figure.legend(
        drawn, names, loc="outside upper center", ncols=2, frameon=False, fontsize=6.5,
        handlelength=2.6, columnspacing=1.2,
    )  # fmt: skip
    return figure


def draw_panels(
    column: Sequence[Axes], panels: Sequence[tuple[str, Lines]], curve: Curve, words: str
) -> list[list[LineEnd]]:
    """Draw panels over training below each other; returns where each one's lines end.

    Runs without a value on the grid of steps are left out.

    Args:
        column: axes.
        panels: title and lines of each.
        curve: what they show.
        words: the same in words.
    """
    steps = grid_of(run for _, lines in panels for _, runs, _ in lines for run in runs)
    ends = []
    for axes, (title, lines) in zip(column, panels, strict=True):
        axes.set_title(title)
        axes.set_ylabel(words)
        axes.set_xlim(0, steps[-1] / 1e6)
        axes.grid(axis="y", linewidth=0.3)
        own = []
        for name, runs, number in lines:
            curves = np.array([curve(run, steps) for run in runs])
            curves = curves[~np.isnan(curves).all(axis=1)]
            if len(curves):
                own.append(_draw_line(axes, steps, number, name, curves))
        ends.append(own)
    # One scale for all panels makes them comparable.
    low = min(axes.get_ylim()[0] for axes in column)
    high = max(axes.get_ylim()[1] for axes in column)
    for axes in column:
        axes.set_ylim(low, high)
    return ends


def name_ends(figure: Figure, column: Sequence[Axes], ends: Sequence[Sequence[LineEnd]]) -> None:
    """Write names beside lines that ``draw_panels`` drew, apart from each other, with thin leaders.

    It is the last thing that is done to a figure.

    Args:
        figure: with the axes in ``column`` below each other, and their limits set.
        column: axes.
        ends: of each one's lines.
    """
    # Room for the names, then names: they need to know how tall the axes came out.
    column[-1].set_xlabel("environment steps, millions")
    column[-1].xaxis.set_major_locator(MaxNLocator(4))
    layout: Any = figure.get_layout_engine()
    longest_name = max(len(name) for own in ends for name, *_ in own)
    layout.set(rect=(0, 0, 0.92 - 0.0135 * longest_name, 1))
    figure.draw_without_rendering()
    right = 1.06 * column[0].get_xlim()[1]
    for axes, own in zip(column, ends, strict=True):
        low, high = axes.get_ylim()
        # 6.5 pt letters need 8 pt from line to line.
        gap = 8.0 / 72.0 / (axes.get_position().height * figure.get_figheight()) * (high - low)
        ordered = sorted(own, key=lambda end: end[2])
        places = apart([y for _, _, y, _ in ordered], gap, low, high)
        for (name, x, y, colour), place in zip(ordered, places, strict=True):
            # Fainter than the line: one that ended early does not go on.
            leader = {"linewidth": 0.5, "alpha": 0.4, "clip_on": False}
            axes.plot([x, right], [y, place], color=colour, solid_capstyle="butt", **leader)
            axes.text(right, place, f" {name}", va="center", fontsize=6.5, clip_on=False)
    # The names are not the layout's business.
    figure.set_layout_engine("none")


def _draw_line(
    axes: Axes, steps: np.ndarray, number: int, name: str, curves: np.ndarray
) -> LineEnd:
    """Draw the IQM and the interval over seeds; returns where the line ends.

    The line breaks where a run ends before the others: from there it is a mean over fewer runs, and
    thinner.

    Args:
        axes: whose x is in millions of steps.
        steps: rising, ``(points,)``.
        number: of the line's colour.
        name: of the line.
        curves: ``(seeds, points)``; NaN where a run has not come so far.
    """
    colour, dash = _stroke(number)
    middle, low, high = band(curves)
    million = steps / 1e6
    present = (~np.isnan(curves)).sum(axis=0)
    for some in sorted({*present.tolist()} - {0}):
        axes.plot(
            million, np.where(present == some, middle, np.nan), color=colour, linestyle=dash,
            linewidth=1.2 if some == len(curves) else 0.6,
        )  # fmt: skip
    axes.fill_between(million, low, high, color=colour, alpha=0.15, linewidth=0)
    last = np.flatnonzero(~np.isnan(middle))[-1]
    return name, float(million[last]), float(middle[last]), colour


def _stroke(number: int) -> tuple[str, Any]:
    """Colour and dashes of a line."""
    return COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)]


def _evaluated(run: Record, steps: np.ndarray) -> np.ndarray:
    """Success of the mean action, straight from evaluation to evaluation."""
    at, success = np.array(evaluations(run)).T
    return np.interp(steps, at, success, left=np.nan, right=np.nan)
