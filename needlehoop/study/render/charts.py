"""Bars and dots: final values, successes against cheats, time to a threshold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlehoop.study.data import paper
from needlehoop.study.data.combinations import HUMAN, label, reward_label
from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.render.curves import MissingDataError, steps_to_share
from needlehoop.study.render.style import (
    CHEAT,
    COLOURS,
    FAINT,
    INK,
    SUCCESS,
    explain_views,
    new_figure,
)
from needlehoop.study.stats.statistics import ENOUGH, Estimate, no_interval

THRESHOLD = 0.5
"""Success rate that a run has to reach."""

_ROW = 4.2
"""Height of a bar and its gap, mm."""


def final_values(findings: Findings) -> Figure:
    """Combinations by final return, with success beside it and the paper's return marked.

    Raises:
        MissingDataError: no run has a final value.
    """
    results = findings.ranked
    if not results:
        raise MissingDataError("no final values")
    successes = [result.success for result in results if result.success is not None]
    columns = 2 if successes else 1
    figure, grid = new_figure(26 + _ROW * len(results), 1, columns, sharey=True)
    _rows(grid[0, 0], [label(result.cameras) for result in results])
    explain_views(figure)
    _bars(grid[0, 0], [result.value for result in results], COLOURS[0], "{:.1f}", 1.0, 9.0)
    grid[0, 0].set_xlabel("final return")
    if findings.study is None:
        grid[0, 0].set_title("As published in the paper")
    grid[0, 0].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 3, 5, 10]))
    *_, most = seeds = sorted({result.value.seeds for result in results})
    if most < ENOUGH:
        most_of = "at most " if len(seeds) > 1 else ""
        grid[0, 0].set_xlabel(f"final return\n({most_of}{no_interval(most)})")
    # The paper's numbers are of the human reward; on its own data they are the bars.
    if findings.study is not None and findings.main_reward == HUMAN:
        known = paper.measured()
        own = [(known[r.cameras], y) for y, r in enumerate(results) if r.cameras in known]
        if own:
            grid[0, 0].plot(
                *zip(*own, strict=True), "D", markersize=3.2, markerfacecolor="white",
                markeredgecolor=INK, markeredgewidth=0.7, label="the paper's return",
                clip_on=False, zorder=5,
            )  # fmt: skip
            figure.legend(loc="outside lower right", frameon=False, fontsize=6.5, handletextpad=0.2)
    if successes:
        _bars(grid[0, 1], successes, COLOURS[2], "{:.0f} %", 100.0, 1.0)
        grid[0, 1].set_xlabel("final success")
        grid[0, 1].set_xticks([0, 0.5, 1], ["0", "50 %", "100 %"])
        grid[0, 1].tick_params(axis="y", length=0)
    return figure


def success_and_cheats(findings: Findings) -> Figure:
    """Success to the right, cheating to the left, for every combination and reward.

    Raises:
        MissingDataError: no run says how often it succeeds.
    """
    results = [r for r in findings.results if r.success is not None and r.cheat is not None]
    if not results:
        raise MissingDataError("no success and cheat rates")
    results.sort(key=lambda r: (-_value(r.success), _value(r.cheat), r.cameras, r.reward))
    figure, grid = new_figure(17 + _ROW * len(results))
    axes = grid[0, 0]
    _rows(axes, [_name(result, findings) for result in results])
    explain_views(figure)
    for estimates, sign, colour in (
        ([r.success for r in results], 1, SUCCESS),
        ([r.cheat for r in results], -1, CHEAT),
    ):
        for y, found in enumerate(estimates):
            assert found is not None
            axes.barh(y, sign * found.value, height=0.66, color=colour)
            beyond = max(found.value, found.high or 0.0)
            if found.low is not None and found.high is not None:
                axes.plot([sign * found.low, sign * found.high], [y, y], color=INK, linewidth=0.8)
            if found.value > 0:
                said, side = f"{100 * found.value:.0f} %", "left" if sign > 0 else "right"
                axes.text(sign * (beyond + 0.03), y, said, va="center", ha=side, fontsize=6)
    axes.axvline(0, color=INK, linewidth=0.6)
    axes.spines["left"].set_visible(False)
    # Wide enough for a bar of 100 % with its number beyond it, in half of a narrow figure.
    axes.set_xlim(-1.7, 1.7)
    axes.set_xticks([-1, 0, 1], ["100 %", "0", "100 %"])
    axes.set_xlabel("share of episodes")
    axes.set_title("◂ cheated", color=CHEAT, loc="left")
    axes.set_title("threaded ▸", color=SUCCESS, loc="right", fontweight="bold")
    return figure


def time_to_threshold(findings: Findings) -> Figure:
    """Environment steps until training succeeds in half of its episodes, a dot for each run.

    Raises:
        MissingDataError: no run has a learning curve.
    """
    found = []
    for result in findings.results:
        if result.reward == findings.main_reward:
            runs = [run for run in result.runs if run.metrics is not None]
            if runs:
                found.append((result, [steps_to_share(run, "success", THRESHOLD) for run in runs]))
    if not found:
        raise MissingDataError("no learning curves")
    found.sort(key=lambda pair: (_median(pair[1]), -pair[0].value.value))
    longest = max(run.steps for result, _ in found for run in result.runs) / 1e6
    figure, grid = new_figure(17 + _ROW * len(found))
    axes = grid[0, 0]
    _rows(axes, [label(result.cameras) for result, _ in found])
    explain_views(figure)
    for y, (_, times) in enumerate(found):
        reached = [time / 1e6 for time in times if time is not None]
        if reached:
            axes.plot(reached, [y] * len(reached), "o", color=COLOURS[0], markersize=3.5,
                      alpha=0.8, markeredgewidth=0, clip_on=False)  # fmt: skip
        how_many = f"{len(reached)} of {len(times)}" if reached else "not reached"
        axes.text(1.04 * longest, y, how_many, va="center", fontsize=6, clip_on=False,
                  color=INK if reached else FAINT)  # fmt: skip
    axes.set_xlim(0, longest)
    axes.grid(axis="both", linewidth=0.3)
    axes.set_xlabel(f"environment steps to {100 * THRESHOLD:.0f} % success in training, millions")
    return figure


def _rows(axes: Axes, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)


def _bars(
    axes: Axes, estimates: Sequence[Estimate], colour: str, form: str, unit: float, full: float
) -> None:
    """Bars with intervals, and their values in units of ``1 / unit`` beside the axes."""
    for y, found in enumerate(estimates):
        axes.barh(y, found.value, height=0.66, color=colour, alpha=0.75)
        if found.low is not None and found.high is not None:
            # In front of the paper's mark, which would hide a narrow one.
            axes.plot([found.low, found.high], [y, y], color=INK, linewidth=0.9, zorder=6)
    lowest = min(0.0, *(min(e.value, e.low or 0.0) for e in estimates))
    highest = max(full, *(max(e.value, e.high or 0.0) for e in estimates))
    axes.set_xlim(lowest, highest)
    for y, found in enumerate(estimates):
        said = form.format(unit * found.value)
        axes.text(1.07 * highest, y, said, va="center", fontsize=6, clip_on=False)


def _name(result: Result, findings: Findings) -> str:
    name = label(result.cameras)
    own = result.reward == findings.main_reward
    return name if own else f"{name}: {reward_label(result.reward)}"


def _value(found: Estimate | None) -> float:
    return 0.0 if found is None else found.value


def _median(times: Sequence[float | None]) -> float:
    return float(np.median([np.inf if time is None else time for time in times]))
