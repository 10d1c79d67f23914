"""What predictions cost, and what is lost by choosing cameras by them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlehoop.study.data import paper
from needlehoop.study.data.findings import Findings
from needlehoop.study.data.predictions import Prediction
from needlehoop.study.render.curves import MissingDataError
from needlehoop.study.render.style import COLOURS, FAINT, INK, apart, new_figure
from needlehoop.study.report.rankings import (
    MEASURED,
    MEASURED_SOON,
    OURS,
    PAPERS_MEASURED,
    list_name,
    measured,
)
from needlehoop.study.report.table import Table
from needlehoop.study.stats.agreement import agreement
from needlehoop.study.stats.measures import TRAINING, by_set, middles
from needlehoop.study.stats.reliability import (
    ONE_SEED,
    Repeat,
    repeat,
    spread,
)

_MINUTE, _LONGEST = 1.0, 1e5
"""Ends of the costs' axis, core-minutes; those who are only asked stand below its beginning."""

_ASKED = 0.25

_TITLES = {
    MEASURED: "of final returns here",
    MEASURED_SOON: "of returns over training here",
    PAPERS_MEASURED: "of the paper's returns",
}

_NAME = 1.8
"""How far from the last point names stand, on the axis of costs, as a factor."""

_FREE = 6.0
"""Where the axis of costs has room between the names of those who are asked and all others."""


@dataclass(frozen=True)
class Bargain:
    """A prediction's cost beside its regrets."""

    who: str
    core_minutes: float | None
    regrets: Mapping[frozenset[str], float]
    """Best measured value less the predicted best's, by list, in points of return."""
    interval: tuple[float, float] | None = None
    """95 %, over other seeds of what was measured, of the mean over the lists."""

    @property
    def regret(self) -> float:
        """The mean over the lists."""
        return sum(self.regrets.values()) / len(self.regrets)


@dataclass(frozen=True)
class Market:
    """All predictions against one measurement."""

    against: str
    bargains: tuple[Bargain, ...]
    blind: Mapping[frozenset[str], float]
    """Regret of a set that is drawn from a list, by list: the mean over its sets."""


def markets(findings: Findings) -> list[Market]:
    """Against what was measured here, in the end and over training, and the paper's numbers.

    What was measured here is foretold by each of its own seeds, too, where there are several.
    Lists are left out of which a set was not measured, and measurements with none left.
    """
    truths: dict[str, Mapping[str, float]] = {}
    if findings.study is not None:
        truths |= {MEASURED: measured(findings), MEASURED_SOON: middles(findings, TRAINING)}
    truths[PAPERS_MEASURED] = paper.measured()
    found = []
    for against, values in truths.items():
        measure = OURS.get(against)
        own = by_set(findings, measure) if measure else {}
        lists = [m for m in map(frozenset, findings.lists.values()) if m <= set(values)]
        blind = {m: _best(values, m) - sum(values[name] for name in m) / len(m) for m in lists}
        bargains = [_bargain(one, values, lists, own) for one in findings.predictions]
        if measure:
            bargains.append(_of_one_seed(repeat(findings, measure)))
        if kept := tuple(one for one in bargains if one.regrets):
            found.append(Market(against, kept, blind))
    return found


def costs(findings: Findings) -> Table:
    """A row for each prediction and measurement, the smallest regret first."""
    rows = []
    for market in markets(findings):
        for one in sorted(market.bargains, key=lambda one: (one.regret, one.who)):
            blind = sum(market.blind[m] for m in one.regrets) / len(one.regrets)
            cost = "not on record" if one.core_minutes is None else f"{one.core_minutes:.0f}"
            names = ", ".join(list_name(members) for members in one.regrets)
            interval = "" if one.interval is None else "{:.2f} to {:.2f}".format(*one.interval)
            regrets = (f"{one.regret:.2f}", interval, f"{blind:.2f}")
            rows.append((one.who, market.against, *regrets, cost, names))
    head = ("prediction", "against", "regret", "regret, 95 %", "chosen blindly", "core-minutes")
    note = (
        "Regret: return of a list's best set less that of the predicted best, mean over the lists."
        " Core-minutes: wall time of the cores that computed the ranking of all sets, training"
        " included, on machines that often did other work as well; 0: a model was only asked."
        f" {ONE_SEED.capitalize()}: of what was measured, to choose by; the regret is the others'."
    )
    return Table("cost", "What predictions cost and lose", (*head, "lists"), tuple(rows), note)


def cost_and_regret(findings: Findings) -> Figure:
    """Cost to the right, regret upwards, a panel for each measurement.

    Raises:
        MissingDataError: nothing that was foretold has been measured.
    """
    shown = markets(findings)
    if not shown:
        raise MissingDataError("no list has both been foretold and measured")
    whos = list(dict.fromkeys(one.who for market in shown for one in market.bargains))
    figure, grid = new_figure(52 * len(shown), len(shown), 1, sharex=True)
    for axes, market in zip(grid[:, 0], shown, strict=True):
        _panel(axes, market, whos)
    grid[-1, 0].set_xlabel("core-minutes for a ranking of all sets")
    return figure


def _panel(axes: Axes, market: Market, whos: list[str]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(_ASKED / 2, _LONGEST)
    axes.set_xticks([_ASKED, 1, 10, 100, 1000], ["only\nasked", "1", "10", "100", "1,000"])
    axes.minorticks_off()
    axes.set_title(_TITLES[market.against])
    axes.set_ylabel("regret, points of return")
    blind = sum(market.blind.values()) / len(market.blind)
    highest = max([blind, *(r for one in market.bargains for r in one.regrets.values())])
    axes.set_ylim(-0.06 * highest, 1.1 * highest or 1.0)
    axes.axhline(blind, color=FAINT, linewidth=0.8, linestyle="--")
    axes.text(_FREE, blind, "chosen blindly", va="bottom", fontsize=6, color=FAINT)
    placed = [one for one in market.bargains if one.core_minutes is not None]
    for one in placed:
        colour, x = COLOURS[whos.index(one.who) % len(COLOURS)], _x(one)
        regrets = [*one.regrets.values()]
        axes.plot([x] * len(regrets), regrets, "o", markersize=2.2, color=colour, alpha=0.45)
        if one.interval is not None:
            axes.plot([x, x], one.interval, color=colour, linewidth=0.9, zorder=3)
        axes.plot([x], [one.regret], "o", markersize=5.5, color=colour, zorder=4)
    asked = [one for one in placed if not one.core_minutes]
    for named in (asked, [one for one in placed if one not in asked]):
        _names(axes, named, whos)


def _names(axes: Axes, named: list[Bargain], whos: list[str]) -> None:
    """Names to the right of all their points, above each other, with a line to each."""
    low, high = axes.get_ylim()
    stacked = sorted(named, key=lambda one: one.regret)
    gap = 0.08 * (high - low)
    heights = apart([one.regret for one in stacked], gap, low + gap / 2, high)
    for one, y in zip(stacked, heights, strict=True):
        colour, x = COLOURS[whos.index(one.who) % len(COLOURS)], max(map(_x, named))
        said = one.who.replace("the paper's", "paper's")
        axes.plot([_x(one), _NAME * x], [one.regret, y], color=colour, linewidth=0.5, alpha=0.6)
        axes.text(1.1 * _NAME * x, y, said, va="center", fontsize=6.5, color=INK)


def _x(one: Bargain) -> float:
    return max(one.core_minutes, _MINUTE) if one.core_minutes else _ASKED


def _bargain(
    one: Prediction,
    values: Mapping[str, float],
    lists: list[frozenset[str]],
    runs: Mapping[str, list[float]],
) -> Bargain:
    """Of a prediction; its interval where ``runs`` has enough seeds of what it is held against."""
    ranked = [m for m in lists if len(one.lists.get(m, {})) == len(m)]
    regrets = {
        members: agreement(one.lists[members], {name: values[name] for name in members}).regret
        for members in ranked
    }
    over_seeds = spread([one.lists[m] for m in ranked], runs)
    return Bargain(one.who, one.core_minutes, regrets, over_seeds.regret if over_seeds else None)


def _of_one_seed(found: Repeat) -> Bargain:
    """Of a study's own seeds; without regrets where it has one of each set."""
    regrets = {
        members: sum(one.regret for one in seeds) / len(seeds)
        for members, seeds in found.lists.items()
    }
    return Bargain(ONE_SEED, found.core_minutes, regrets)


def _best(values: Mapping[str, float], members: frozenset[str]) -> float:
    return max(values[name] for name in members)
