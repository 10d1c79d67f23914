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
from needlehoop.study.render.style import COLOURS, DASHES, in_percent, new_figure, short
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.run import evaluations, grid_of, has_curve, smooth
from needlehoop.study.stats.statistics import band

_PANEL = 7
"""Curves in a panel, at most: one for each colour."""

Lines = Sequence[tuple[str, Sequence[Record], int]]
"""What a panel shows: name, runs and number of the colour of each line."""


class MissingDataError(ValueError):
    """A study lacks what a figure shows; the message says what. Each figure may raise it."""


def learning_curves(findings: StudyFindings) -> Figure:
    """Return over training for each camera set.

    Few share a panel; many are parted into the paper's three lists, if it is of its task, and the
    rest.
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
    draw_panels(grid[:, 0], shown, partial(smooth, column="return"), "return in training", True)
    count_steps(grid[-1, 0])
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
    """
    known = [one for one in findings.results if any(map(has_curve, one.runs))]
    known.sort(key=lambda one: reward_order(one.reward))
    names = [result.cameras for result in findings.ranked]
    rivals = {cameras: [one for one in known if one.cameras == cameras] for cameras in names}
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
    figure.legend(
        drawn, [short(reward_label(reward)) for reward in colours], loc="outside upper center",
        ncols=2, frameon=False, fontsize=6.5, handlelength=2.6, columnspacing=1.2,
    )  # fmt: skip
    return figure


def draw_panels(
    column: Sequence[Axes],
    panels: Sequence[tuple[str, Lines]],
    curve: Callable[[Record, np.ndarray], np.ndarray],
    words: str,
    named: bool = False,
) -> None:
    """Draw panels over training below each other.

    Runs without a value on the grid of steps are left out.

    Args:
        column: axes.
        panels: title and lines of each.
        curve: a run's values on a grid of steps, NaN where it has none.
        words: what the curves show.
        named: whether each panel has its lines' names beside it, in the order of their ends.
    """
    steps = grid_of(run for _, lines in panels for _, runs, _ in lines for run in runs)
    for axes, (title, lines) in zip(column, panels, strict=True):
        axes.set_title(title)
        axes.set_ylabel(words)
        axes.set_xlim(0, steps[-1] / 1e6)
        axes.grid(axis="y", linewidth=0.3)
        drawn = []
        for name, runs, number in lines:
            curves = np.array([curve(run, steps) for run in runs])
            curves = curves[~np.isnan(curves).all(axis=1)]
            if len(curves):
                drawn.append((*_draw_line(axes, steps, number, curves), name))
        if named and drawn:
            _, handles, names = zip(*sorted(drawn, key=lambda own: -own[0]), strict=True)
            axes.legend(
                handles, names, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False,
                fontsize=6.5, handlelength=2.2,
            )  # fmt: skip
    # One scale for all panels makes them comparable.
    low = min(axes.get_ylim()[0] for axes in column)
    high = max(axes.get_ylim()[1] for axes in column)
    for axes in column:
        axes.set_ylim(low, high)


def count_steps(axes: Axes) -> None:
    """Say what stands below the lowest panel of training."""
    axes.set_xlabel("environment steps, millions")
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _draw_line(
    axes: Axes, steps: np.ndarray, number: int, curves: np.ndarray
) -> tuple[float, Line2D]:
    """Draw the IQM and the interval over seeds; returns the last value, and the line.

    The line breaks where a run ends before the others: from there it is a mean over fewer runs, and
    thinner. Curves are ``(seeds, points)``, NaN where a run has not come so far.
    """
    colour, dash = _stroke(number)
    middle, low, high = band(curves)
    million = steps / 1e6
    present = (~np.isnan(curves)).sum(axis=0)
    lines = [
        axes.plot(
            million, np.where(present == some, middle, np.nan), color=colour, linestyle=dash,
            linewidth=1.2 if some == len(curves) else 0.6,
        )[0]
        for some in sorted({*present.tolist()} - {0})
    ]  # fmt: skip
    axes.fill_between(million, low, high, color=colour, alpha=0.15, linewidth=0)
    return float(middle[~np.isnan(middle)][-1]), lines[-1]


def _stroke(number: int) -> tuple[str, Any]:
    return COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)]


def _evaluated(run: Record, steps: np.ndarray) -> np.ndarray:
    """Success of the mean action, straight from evaluation to evaluation."""
    at, success = np.array(evaluations(run)).T
    return np.interp(steps, at, success, left=np.nan, right=np.nan)
