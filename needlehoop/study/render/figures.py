"""The figures of a study: the paper's Figures 6 and 7, final values, and all of them as files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy import stats

from needlehoop.study.data import paper
from needlehoop.study.data.paper import reward_label, reward_order
from needlehoop.study.data.records import Record
from needlehoop.study.render.style import COLOURS, DASHES, INK, new_figure, save, short, styled
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.run import CHEAT, evaluations, has_curve, smooth
from needlehoop.study.stats.statistics import ENOUGH, Estimated, Interval

_PANEL = 7
"""Most curves in one panel; more are split into lists."""

_POINTS = 120
"""Most points of a curve."""

Lines = Sequence[tuple[str, Sequence[Record], int]]
"""What a panel shows: name, runs and number of the colour of each line."""


def learning_curves(findings: StudyFindings) -> Figure | None:
    """Return over training for each camera set; many are parted into the study's lists."""
    drawn = {one.cameras: one.runs for one in findings.ranked if any(map(has_curve, one.runs))}
    if not drawn:
        return None
    panels = {"": [*drawn]}
    if len(drawn) > _PANEL:
        lists = findings.lists.items()
        panels = {name: [cams for cams in drawn if cams in sets] for name, sets in lists}
        listed = {cams for sets in panels.values() for cams in sets}
        panels["Others"] = [cams for cams in drawn if cams not in listed]
    shown = [
        (title, [(short(cams), drawn[cams], i) for i, cams in enumerate(sets)])
        for title, sets in panels.items()
        if sets
    ]
    figure, grid = new_figure(6 + 46 * len(shown), len(shown), sharex=True)
    draw_panels(grid[:, 0], shown, partial(smooth, column="return"), "return in training", True)
    return figure


def reward_comparison(findings: StudyFindings) -> Figure | None:
    """What training brings by reward, for each camera set that was trained with several.

    Beside the returns stands how often training's sampled actions succeed, and how often the mean
    action does in evaluations: it can stop short where noise still gets there.
    """
    known = [result for result in findings.results if any(map(has_curve, result.runs))]
    known.sort(key=lambda result: reward_order(result.reward))
    rivals = {best.cameras: [result for result in known if result.cameras == best.cameras]
              for best in findings.ranked}  # fmt: skip
    rivals = {cameras: group for cameras, group in rivals.items() if len(group) > 1}
    if not rivals:
        return None
    # A reward keeps its colour from panel to panel.
    colours = sorted({one.reward for group in rivals.values() for one in group}, key=reward_order)
    panels = [
        (short(cameras), [(one.reward, one.runs, colours.index(one.reward)) for one in group])
        for cameras, group in rivals.items()
    ]
    untitled = [("", lines) for _, lines in panels]
    figure, grid = new_figure(17 + 36 * len(panels), len(panels), 3, sharex=True)
    draw_panels(grid[:, 0], panels, partial(smooth, column="return"), "return in its own points")
    draw_panels(grid[:, 1], untitled, partial(smooth, column="success"), findings.goal)
    draw_panels(grid[:, 2], untitled, _evaluated, "")
    for axes in grid[:, 1:].flat:
        axes.set_ylim(-0.05, 1.05)
        axes.set_yticks([0, 0.5, 1], ["0", "50 %", "100 %"])
    for axes, title in zip(grid[0, 1:], ("in training", "in evaluations"), strict=True):
        axes.set_title(title, fontweight="normal", fontsize=6.5)
    for axes in grid[:, 2]:
        axes.tick_params(labelleft=False)
    for axes in grid[-1, ::2]:
        axes.set_xlabel("")
    # Each reward has one colour in all panels, so one legend is enough.
    drawn = [Line2D([], [], **_stroke(number)) for number in range(len(colours))]
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
    """Draw panels over training below each other: the mean and the interval over seeds.

    ``curve`` gives a run's values on a grid of steps, NaN where it has none. Where ``named``, the
    lines' names stand beside each panel in the order of their ends.
    """
    every = [run for _, lines in panels for _, runs, _ in lines for run in runs]
    # No more points than buffers, or a short run's line has stairs.
    buffers = max(len(run.metrics) for run in every if run.metrics is not None)
    steps = np.linspace(0, max(run.steps for run in every), min(_POINTS, buffers) + 1)
    for axes, (title, lines) in zip(column, panels, strict=True):
        axes.set_title(title)
        axes.set_ylabel(words)
        axes.set_xlim(0, steps[-1] / 1e6)
        axes.grid(axis="y", linewidth=0.3)
        ends = []
        for name, runs, number in lines:
            middle, low, high = _band(np.array([curve(run, steps) for run in runs]))
            stroke = _stroke(number)
            (line,) = axes.plot(steps / 1e6, middle, **stroke)
            axes.fill_between(
                steps / 1e6, low, high, color=stroke["color"], alpha=0.15, linewidth=0
            )
            ends.append((max(middle[~np.isnan(middle)][-1:], default=0.0), line, name))
        if named:
            _, handles, names = zip(*sorted(ends, key=lambda end: -end[0]), strict=True)
            axes.legend(
                handles, names, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False,
                fontsize=6.5, handlelength=2.2,
            )  # fmt: skip
    # One scale for all panels makes them comparable.
    low = min(axes.get_ylim()[0] for axes in column)
    high = max(axes.get_ylim()[1] for axes in column)
    for axes in column:
        axes.set_ylim(low, high)
    column[-1].set_xlabel("environment steps, millions")
    column[-1].xaxis.set_major_locator(MaxNLocator(3))


def _band(curves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of curves ``(seeds, points)``, and Student's interval where there are enough.

    A curve is NaN where its run has no value. Three times ``(points,)``.
    """
    held = np.ma.masked_invalid(curves)
    count = np.where(held.count(axis=0) < ENOUGH, np.nan, held.count(axis=0))
    middle = held.mean(axis=0).filled(np.nan)
    half = stats.t.ppf(0.975, count - 1) * held.std(axis=0, ddof=1).filled(np.nan) / np.sqrt(count)
    return middle, middle - half, middle + half


def _stroke(number: int) -> dict[str, Any]:
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": DASHES[number % len(DASHES)]}


def _evaluated(run: Record, steps: np.ndarray) -> np.ndarray:
    """Success of the mean action, straight from evaluation to evaluation."""
    at, success = np.array(evaluations(run)).T
    return np.interp(steps, at, success, left=np.nan, right=np.nan)


def final_values(findings: StudyFindings) -> Figure:
    """Camera sets by final return, with the paper's return, success and cheats beside it."""
    results = findings.ranked
    shares = {findings.goal: [one.success for one in results]}
    cheats = [one.middle(CHEAT) for one in results]
    if all(one is not None for one in cheats):
        shares[CHEAT] = [Estimated(one or 0.0) for one in cheats]
    # 4.2 mm for a bar and its gap.
    height, widths = 26 + 4.2 * len(results), (3, 2, 1)[: 1 + len(shares)]
    figure, grid = new_figure(height, 1, len(widths), sharey=True, width_ratios=widths)
    left, *right = grid[0]
    _bars(left, [one.value for one in results], COLOURS[0], "{:.1f}", 1.0, 9.0)
    left.set_yticks(range(len(results)), [short(one.cameras) for one in results])
    left.set_ylim(len(results) - 0.4, -0.6)
    left.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 3, 5, 10]))
    left.set_xlabel("final return")
    for axes, (name, rates), colour in zip(right, shares.items(), COLOURS[2:0:-1], strict=False):
        _bars(axes, rates, colour, "{:.0f} %", 100.0, 1.0)
        axes.set_xlabel(name)
        axes.set_xticks([0, 1], ["0", "100 %"])
    # The paper's numbers are of the human reward.
    if findings.is_papers and findings.main_reward == paper.HUMAN:
        known = paper.measured()
        places = [y for y, one in enumerate(results) if one.cameras in known]
        left.plot(
            [known[results[y].cameras] for y in places], places, "D", markersize=3.2,
            markerfacecolor="white", markeredgecolor=INK, markeredgewidth=0.7,
            label="the paper's return", clip_on=False, zorder=5,
        )  # fmt: skip
        figure.legend(loc="outside lower right", frameon=False, fontsize=6.5, handletextpad=0.2)
    return figure


def _bars(
    axes: Axes, estimates: Sequence[Estimated], colour: str, form: str, unit: float, full: float
) -> None:
    """Bars with intervals, and their values in units of ``1 / unit`` beside the axes."""
    ends = [one.interval or Interval(one.value, one.value) for one in estimates]
    highest = max(full, *(end.high for end in ends))
    axes.set_xlim(min(0.0, *(end.low for end in ends)), highest)
    axes.tick_params(axis="y", length=0)
    for y, (estimated, end) in enumerate(zip(estimates, ends, strict=True)):
        axes.barh(y, estimated.value, height=0.66, color=colour, alpha=0.75)
        # In front of the paper's mark, which would hide a narrow one.
        axes.plot([end.low, end.high], [y, y], color=INK, linewidth=0.9, zorder=6)
        label = form.format(unit * estimated.value)
        axes.text(1.07 * highest, y, label, va="center", fontsize=6, clip_on=False)


_FIGURES: dict[str, tuple[Callable[[StudyFindings], Figure | None], str]] = {
    "rewards": (
        reward_comparison,
        "Rewards compared. Left: each curve is in its own reward's points. Right, what compares"
        " across rewards: success in training, of sampled actions, and in evaluations, of the mean"
        " action, which may stop short where noise still gets there.",
    ),
    "final_values": (
        final_values,
        "Camera sets by final return, with success and cheating, which looks like success and is"
        " not; means over seeds, and 95 % intervals: of returns over three seeds or more, of shares"
        " over episodes where there are fewer.",
    ),
    "learning_curves": (
        learning_curves,
        "Return over training: mean over seeds, with 95 % intervals where there are three or more;"
        " each point is the mean over the last 4 % of the longest run. Training samples its"
        " actions, so a curve ends below the final return, which is of the mean action.",
    ),
}


@dataclass(frozen=True)
class Drawn:
    """A figure's file."""

    name: str
    caption: str
    file: Path


def draw(findings: StudyFindings, folder: Path) -> list[Drawn]:
    """Draw everything there is data for, as PNG; what older calls left in the folder goes."""
    drawn = []
    for name, (figure, caption) in _FIGURES.items():
        (folder / f"{name}.png").unlink(missing_ok=True)
        with styled():
            if (made := figure(findings)) is not None:
                drawn.append(Drawn(name, caption, save(made, folder / name)))
    return drawn
