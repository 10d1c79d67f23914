"""What predictions of the best cameras cost, how well they agree, and what they lose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.seeds import Spread, repeat, spread
from needlehoop.runs.files import CONFIG, EXPERT, MANIFEST
from needlehoop.runs.reading import read_json, read_yaml
from needlehoop.study.data.records import Record, read_study
from needlehoop.study.render.style import COLOURS, FAINT, INK, apart, new_figure
from needlehoop.study.stats.agreement import agreement, pooled
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.predictions import (
    FAST,
    IMITATION,
    MEASURED,
    PAPERS_MEASURED,
    PROBE,
    Prediction,
)
from needlehoop.study.stats.run import RETURN, TRAINING

ONE_SEED = "one seed"
"""A single seed of a study, held against its others."""

OURS = {MEASURED: RETURN, TRAINING.name: TRAINING}
"""What predictions are held against, of a study's own runs."""

_MINUTE, _LONGEST = 1.0, 1e5
"""Ends of the costs' axis, core-minutes; models that are only asked stand before its beginning."""

_ASKED = 0.25

_TITLES = {
    MEASURED: "Regret by our final returns",
    TRAINING.name: "Regret by our returns over training",
    PAPERS_MEASURED: "Regret by the paper's returns",
}

_NAME = 1.8
"""How far from the last point names stand, on the axis of costs, as a factor."""

_FREE = 6.0
"""Where the axis of costs has room between the names of models and all others."""


@dataclass(frozen=True)
class Fit:
    """A prediction held against a measurement, over all lists that both have."""

    who: str
    tau: float | None
    """Mean tau-b over the lists; ``None`` where there is one list alone."""
    p: float | None
    """Of that tau-b; ``None`` for seeds, which are on either side in turn."""
    regrets: Mapping[frozenset[str], float]
    """Best measured value less the predicted best's, by list, in points of return."""
    core_minutes: float | None
    """``None`` where they are not on record."""
    over_seeds: Spread | None = None

    @property
    def regret(self) -> float:
        """The mean over the lists."""
        return sum(self.regrets.values()) / len(self.regrets)


@dataclass(frozen=True)
class Held:
    """All predictions against one measurement."""

    against: str
    fits: tuple[Fit, ...]
    blind: float
    """Regret of a camera set that is drawn from a list: the mean over its sets, and the lists."""

    @property
    def whole(self) -> tuple[Fit, ...]:
        """Those that rank all lists, whose means can stand beside each other."""
        most = max(len(one.regrets) for one in self.fits)
        return tuple(one for one in self.fits if len(one.regrets) == most)


def held(findings: StudyFindings) -> list[Held]:
    """Against what was measured here, in the end and over training, and the paper's numbers.

    What was measured here is foretold by each of its own seeds, too, where there are several.
    Lists with a camera set that was not measured are left out.
    """
    found = []
    for truth, values in findings.truths.items():
        lists = [m for m in map(frozenset, findings.lists.values()) if m <= set(values)]
        if truth not in _TITLES or not lists:
            continue
        runs = findings.by_set(OURS[truth]) if truth in OURS else {}
        fits = [_fit(one, lists, values, runs, findings) for one in findings.predictions_of(truth)]
        if truth in OURS:
            fits.append(_of_one_seed(findings, truth))
        worth = [np.array([values[name] for name in members]) for members in lists]
        blind = float(np.mean([own.max() - own.mean() for own in worth]))
        if kept := tuple(one for one in fits if one.regrets):
            found.append(Held(truth, kept, blind))
    return found


def _fit(
    one: Prediction,
    lists: list[frozenset[str]],
    values: Mapping[str, float],
    runs: Mapping[str, list[float]],
    findings: StudyFindings,
) -> Fit:
    """Of a prediction; with intervals where ``runs`` has enough seeds."""
    ranked = [members for members in lists if len(one.lists.get(members, {})) == len(members)]
    sides = [(one.lists[m], {name: values[name] for name in m}) for m in ranked]
    regrets = {m: agreement(*both).regret for m, both in zip(ranked, sides, strict=True)}
    tau = p = None
    if len(sides) > 1:
        together = pooled(sides)
        tau, p = together.tau, together.tau_p
    cost = prediction_cost(one.who, _studies(findings))
    return Fit(one.who, tau, p, regrets, cost, spread([scores for scores, _ in sides], runs))


def _of_one_seed(findings: StudyFindings, truth: str) -> Fit:
    """Of a study's own seeds; without regrets where it has one of each camera set."""
    found = repeat(findings, OURS[truth])
    taus = [one.tau for seeds in found.values() for one in seeds]
    tau = float(np.nanmean(taus)) if len(found) > 1 and not np.isnan(taus).all() else None
    regrets = {m: float(np.mean([one.regret for one in seeds])) for m, seeds in found.items()}
    minutes = [[core_minutes(run) for run in result.runs] for result in findings.ranked]
    if any(None in own for own in minutes):
        return Fit(ONE_SEED, tau, None, regrets, None)
    cost = sum(float(np.mean([one for one in own if one is not None])) for own in minutes)
    return Fit(ONE_SEED, tau, None, regrets, cost)


def _studies(findings: StudyFindings) -> Path:
    """The folder that the study is in."""
    assert findings.study is not None
    return findings.study.folder.resolve().parent


@cache
def prediction_cost(who: str, studies: Path) -> float | None:
    """Core-minutes that a prediction's scores of all camera sets took.

    A model that is asked takes none of ours.
    """
    if who == PAPERS_MEASURED:
        return None
    if who == PROBE:
        manifest, config = (studies / "probe" / name for name in (MANIFEST, CONFIG))
        if not (manifest.exists() and config.exists()):
            return None
        return _minutes(read_json(manifest), read_yaml(config))
    folders = {IMITATION: "imitation", FAST: "fast"}
    if who not in folders:
        return 0.0
    minutes = [
        core_minutes(run)
        for run in read_study(studies / folders[who]).runs
        if (run.place.reward == EXPERT) == (who == IMITATION) and run.finished
    ]
    known = [one for one in minutes if one is not None]
    return sum(known) if len(known) == len(minutes) else None


def core_minutes(run: Record) -> float | None:
    """Wall time of a run's cores, whatever else they did; ``None`` if it is not on record."""
    return _minutes(run.manifest, run.config)


def _minutes(manifest: Mapping, config: Mapping) -> float | None:
    cores = (config.get("engine") or {}).get("threads") or manifest.get("cpus")
    wall = manifest.get("wall_time")
    return wall * cores / 60.0 if cores and wall else None


def cost_and_regret(findings: StudyFindings) -> Figure:
    """Cost to the right, regret upwards, a panel for each measurement.

    Raises:
        ValueError: nothing that was predicted has been measured.
    """
    shown = held(findings)
    if not shown:
        raise ValueError("no list has both been predicted and measured")
    placed = [[one for one in own.whole if one.core_minutes is not None] for own in shown]
    whos = list(dict.fromkeys(one.who for own in placed for one in own))
    colours = {who: COLOURS[i % len(COLOURS)] for i, who in enumerate(whos)}
    figure, grid = new_figure(52 * len(shown), len(shown), 1, sharex=True)
    for axes, own, fits in zip(grid[:, 0], shown, placed, strict=True):
        _panel(axes, own, fits, colours)
    grid[-1, 0].set_xlabel("core-minutes for a ranking of all sets")
    return figure


def _panel(axes: Axes, own: Held, fits: list[Fit], colours: Mapping[str, str]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(_ASKED / 2, _LONGEST)
    axes.set_xticks([_ASKED, 1, 10, 100, 1000], ["only\nasked", "1", "10", "100", "1,000"])
    axes.minorticks_off()
    axes.set_title(_TITLES[own.against])
    axes.set_ylabel("regret, points of return")
    highest = max([own.blind, *(regret for one in fits for regret in one.regrets.values())])
    axes.set_ylim(-0.06 * highest, 1.1 * highest or 1.0)
    axes.axhline(own.blind, color=FAINT, linewidth=0.8, linestyle="--")
    axes.text(_FREE, own.blind, "chosen blindly", va="bottom", fontsize=6, color=FAINT)
    for one in fits:
        colour, x = colours[one.who], _x(one)
        regrets = [*one.regrets.values()]
        axes.plot([x] * len(regrets), regrets, "o", markersize=2.2, color=colour, alpha=0.45)
        if one.over_seeds is not None:
            ends = one.over_seeds.regret
            axes.plot([x, x], [ends.low, ends.high], color=colour, linewidth=0.9, zorder=3)
        axes.plot([x], [one.regret], "o", markersize=5.5, color=colour, zorder=4)
    asked = [one for one in fits if not one.core_minutes]
    for named in (asked, [one for one in fits if one not in asked]):
        _names(axes, named, colours)


def _names(axes: Axes, named: list[Fit], colours: Mapping[str, str]) -> None:
    """Names to the right of all their points, above each other, with a line to each."""
    low, high = axes.get_ylim()
    stacked = sorted(named, key=lambda one: one.regret)
    gap = 0.08 * (high - low)
    heights = apart([one.regret for one in stacked], gap, low + gap / 2, high)
    for one, y in zip(stacked, heights, strict=True):
        x = max(map(_x, named))
        said = one.who.replace("the paper's", "paper's")
        line = {"color": colours[one.who], "linewidth": 0.5, "alpha": 0.6}
        axes.plot([_x(one), _NAME * x], [one.regret, y], **line)
        axes.text(1.1 * _NAME * x, y, said, va="center", fontsize=6.5, color=INK)


def _x(one: Fit) -> float:
    return max(one.core_minutes, _MINUTE) if one.core_minutes else _ASKED
