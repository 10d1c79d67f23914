"""The figures of a study: final values, cheats, rankings, and all of them as files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlehoop.study.data import paper
from needlehoop.study.data.paper import HUMAN, reward_label
from needlehoop.study.render.curves import MissingDataError, learning_curves, reward_comparison
from needlehoop.study.render.style import (
    COLOURS,
    DASHES,
    FAINT,
    INK,
    WIDTH,
    in_percent,
    new_figure,
    save,
    short,
    styled,
)
from needlehoop.study.stats.findings import Result, StudyFindings, robustness
from needlehoop.study.stats.statistics import ENOUGH, Interval, SeedEstimate, no_interval

_ROW = 4.2
"""Height of a bar and its gap, mm."""

_COSTS = 0.05
"""Share of the success that an axis must cost some camera set to be drawn."""

_COLUMNS, _MOST_SETS = 4, 7


def final_values(findings: StudyFindings) -> Figure:
    """Camera sets by final return, with success beside it and the paper's return marked."""
    results = findings.ranked
    if not results:
        raise MissingDataError("no final values")
    successes = [result.success for result in results if result.success is not None]
    columns = 2 if successes else 1
    figure, grid = new_figure(26 + _ROW * len(results), 1, columns, sharey=True)
    _rows(grid[0, 0], [result.cameras for result in results])
    _bars(grid[0, 0], [result.value for result in results], COLOURS[0], "{:.1f}", 1.0, 9.0)
    if findings.study is None:
        grid[0, 0].set_title("As published in the paper")
    grid[0, 0].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 3, 5, 10]))
    *_, most = seeds = sorted({result.value.seeds for result in results})
    most_of = "at most " if len(seeds) > 1 else ""
    why = f"\n({most_of}{no_interval(most)})" if most < ENOUGH else ""
    grid[0, 0].set_xlabel(f"final return{why}")
    # The paper's numbers are of the human reward; on its own data they are the bars.
    if findings.study and findings.is_papers and findings.main_reward == HUMAN:
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
    return figure


def success_and_cheats(findings: StudyFindings) -> Figure:
    """How often every camera set succeeds with every reward, and how often it cheats."""
    known = [
        (one.success, one.cheat, one)
        for one in findings.results
        if one.success is not None and one.cheat is not None
    ]
    if not known:
        raise MissingDataError("no success and cheat rates")
    known.sort(key=lambda own: (-own[0].value, own[1].value, own[2].cameras, own[2].reward))
    *columns, shown = zip(*known, strict=True)
    figure, grid = new_figure(17 + _ROW * len(shown), 1, 2, sharey=True)
    _rows(grid[0, 0], [_name(result, findings) for result in shown])
    heads = (findings.goal, "cheated")
    for axes, own, said, colour in zip(grid[0], columns, heads, COLOURS[:2], strict=True):
        _bars(axes, own, colour, "{:.0f} %", 100.0, 1.0)
        axes.set_title(said, color=colour)
        axes.set_xticks([0, 1], ["0", "100 %"])
    return figure


def stress_figure(findings: StudyFindings) -> Figure:
    """A panel for each axis that costs some camera set anything, a line for each set."""
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
    height = 18 + 22 * rows + 3 * len(shown)
    figure, grid = new_figure(height, rows, _COLUMNS, sharex=True, sharey=True)
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
        in_percent(panel)
        panel.grid(axis="y", color=FAINT, alpha=0.3, linewidth=0.4)
    figure.supxlabel("severity (0: undisturbed)", fontsize=7)
    figure.supylabel("success", fontsize=7)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(3, len(labels)), frameon=False,
        fontsize=6.5,
    )  # fmt: skip
    return figure


def _rows(axes: Axes, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), [*map(short, names)])
    axes.set_ylim(len(names) - 0.4, -0.6)


def _bars(
    axes: Axes, estimates: Sequence[SeedEstimate], colour: str, form: str, unit: float, full: float
) -> None:
    """Bars with intervals, and their values in units of ``1 / unit`` beside the axes."""
    for y, found in enumerate(estimates):
        axes.barh(y, found.value, height=0.66, color=colour, alpha=0.75)
        if found.interval:
            # In front of the paper's mark, which would hide a narrow one.
            axes.plot(_ends(found), [y, y], color=INK, linewidth=0.9, zorder=6)
    lowest = min(0.0, *(_ends(one)[0] for one in estimates))
    highest = max(full, *(max(one.value, _ends(one)[1]) for one in estimates))
    axes.set_xlim(lowest, highest)
    axes.tick_params(axis="y", length=0)
    for y, found in enumerate(estimates):
        said = form.format(unit * found.value)
        axes.text(1.07 * highest, y, said, va="center", fontsize=6, clip_on=False)


def _name(result: Result, findings: StudyFindings) -> str:
    own = result.reward == findings.main_reward
    return result.cameras if own else f"{result.cameras}: {reward_label(result.reward)}"


def _ends(found: SeedEstimate) -> tuple[float, float]:
    """Of the interval; of a value without one, the value twice."""
    ends = found.interval or Interval(found.value, found.value)
    return ends.low, ends.high


_DRAWN: dict[str, tuple[Callable[[StudyFindings], Figure], str]] = {
    "learning_curves": (
        learning_curves,
        "Return over training: mean over seeds, with 95 % intervals where there are three or more;"
        " each point is the mean over the last 4 % of the longest run. Thin: fewer seeds have come"
        " so far. Training samples its actions, so a curve ends below the final return, which is of"
        " the mean action.",
    ),
    "rewards": (
        reward_comparison,
        "Rewards compared. Left: each curve is in its own reward's points."
        " Right, what compares across rewards: the share of training episodes that succeed, of"
        " sampled actions, and of evaluations, of the mean action, which may stop short where"
        " noise still gets there.",
    ),
    "final_values": (
        final_values,
        "Camera sets by final return, with success; means over seeds, and 95 % intervals: of"
        " returns over three seeds or more, of success over episodes where there are fewer.",
    ),
    "stress": (
        stress_figure,
        "Success under disturbances, axis by axis, where an axis costs some camera set five points"
        " or more: undisturbed, then at rising severity. 3 is what a lab or an operating room"
        " shows.",
    ),
    "success_and_cheats": (
        success_and_cheats,
        "Success against cheating: the task done, or what looks like it and is not.",
    ),
}


@dataclass(frozen=True)
class Drawn:
    """A figure's files, or why there are none."""

    name: str
    caption: str
    files: tuple[Path, ...]
    missing: str | None


def draw(findings: StudyFindings, folder: Path) -> list[Drawn]:
    """Draw everything there is data for, as PNG and SVG.

    Older figures in the folder are replaced, or removed where there is nothing to draw any more.
    """
    drawn = []
    for name, (figure, caption) in _DRAWN.items():
        for suffix in (".png", ".svg"):
            (folder / f"{name}{suffix}").unlink(missing_ok=True)
        try:
            with styled(), warnings.catch_warnings():
                # Names that leave no room for the axes.
                warnings.filterwarnings("error", "constrained_layout not applied")
                files = save(figure(findings), folder / name)
            drawn.append(Drawn(name, caption, tuple(files), None))
        except Exception as error:
            # Numbers or names that nobody thought of; the other figures are drawn.
            kind = "" if isinstance(error, MissingDataError) else f"{type(error).__name__}: "
            drawn.append(Drawn(name, caption, (), f"{kind}{error}"))
    return drawn
