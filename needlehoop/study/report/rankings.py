"""Predicted orders beside the measured ones: who said what, and how far it held."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlehoop.study.data import paper
from needlehoop.study.data.combinations import LISTS, label
from needlehoop.study.data.findings import Findings
from needlehoop.study.data.predictions import IMITATION, Prediction, scored
from needlehoop.study.render.curves import MissingDataError
from needlehoop.study.render.style import COLOURS, FAINT, INK, new_figure
from needlehoop.study.report.table import Table
from needlehoop.study.stats.agreement import Agreement, Pooled, agreement, pooled
from needlehoop.study.stats.measures import RETURN, TRAINING, by_set, middles
from needlehoop.study.stats.reliability import (
    ONE_SEED,
    OTHER_SEEDS,
    Spread,
    mean_known,
    repeat,
    spread,
)
from needlehoop.study.stats.statistics import ENOUGH

MEASURED, PAPERS_MEASURED = "measured", "the paper's measured"
MEASURED_SOON = TRAINING.name

OURS = {MEASURED: RETURN, MEASURED_SOON: TRAINING}
"""What predictions are held against, of a study's own runs."""

_CELL = 4.2
"""Height of a row, mm."""


def rankings(findings: Findings) -> Table:
    """The place that each prediction and each measurement gives to each set of each list."""
    shown = _columns(findings)
    rows = []
    for name, members in findings.lists.items():
        places = [one.places(members) for one in shown]
        rows += [
            (
                LISTS.get(name, name),
                label(cameras),
                *(_place(own, cameras, len(members)) for own in places),
            )
            for cameras in _ordered(members, shown)
        ]
    note = (
        "Place in the list, 1 the best; ties share their mean. Models that were asked repeatedly:"
        " by mean place; imitation by success over its seeds. The probe cannot tell all of these"
        " apart: its own table has the intervals."
    )
    head = ("list", "cameras", *(one.who for one in shown))
    return Table("rankings", "Rankings side by side", head, tuple(rows), note)


def ranking_chart(findings: Findings) -> Figure:
    """The same as a picture: a column for each ranking, darker where better.

    Raises:
        MissingDataError: nobody ranked anything.
    """
    shown = _columns(findings)
    blocks = {n: m for n, m in findings.lists.items() if any(one.places(m) for one in shown)}
    if not blocks:
        raise MissingDataError("no rankings")
    height = 20 + sum(5 + _CELL * len(members) for members in blocks.values())
    figure, grid = new_figure(
        height, len(blocks), sharex=True, height_ratios=[len(m) for m in blocks.values()]
    )
    for axes, (name, members) in zip(grid[:, 0], blocks.items(), strict=True):
        ordered = _ordered(members, shown)
        axes.set_xlim(-0.5, len(shown) - 0.5)
        axes.set_ylim(len(ordered) - 0.5, -0.5)
        for x, one in enumerate(shown):
            _column(axes, x, one.places(members), ordered)
        axes.set_yticks(range(len(ordered)), [label(cameras) for cameras in ordered])
        axes.set_title(LISTS.get(name, name))
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
    heads = [one.who.replace("the paper's", "paper's") for one in shown]
    turned = {"rotation": 35, "ha": "right", "rotation_mode": "anchor"}
    grid[-1, 0].set_xticks(range(len(shown)), heads, **turned)
    return figure


def agreements(findings: Findings) -> Table:
    """How well each prediction fits what was measured, here and in the paper, list by list.

    Held against final returns, and against returns over training, of which luck is a smaller
    part. Imitation predicts, and is predicted: what flies ranks cameras as well. Each seed of what
    was measured here predicts the others, too, which says what a prediction can be compared with.
    """
    runs = {against: by_set(findings, measure) for against, measure in OURS.items()}
    rows = []
    for one, against, values in _sides(findings):
        own = runs.get(against, {})
        both: list[tuple[Mapping[str, float], Mapping[str, float]]] = []
        for members, scores in one.lists.items():
            if against != MEASURED and not members <= set(values):
                continue
            missing = [cameras for cameras in members if cameras not in values]
            if missing:
                said = ("",) * 7 + (f"{len(missing)} of {len(members)} not measured", "")
            else:
                both.append((scores, {cameras: values[cameras] for cameras in members}))
                said = _said(agreement(*both[-1]), spread([scores], own))
            rows.append((f"{one.who} against {against}", list_name(members), *said))
        if len(both) > 1:
            said = _together(pooled(both), spread([side for side, _ in both], own))
            rows.append((f"{one.who} against {against}", "all lists", *said))
    repeated = [row for against in OURS for row in _repeated(findings, against)]
    head = ("what", "list", "tau-b", "tau-b, 95 %", "p", "rho", "p", "best found", "worst found")
    note = (
        f"{MEASURED_SOON.capitalize()}: the mean of all training episodes, by steps, which says how"
        " soon cameras let the task be learnt. Two-sided permutation p-values; regret is the return"
        " lost by taking the predicted best, against imitation the share of successes. All lists:"
        " means, p by orders drawn for each"
        " list by itself. Intervals: over other seeds of what was measured, where each set has"
        f" {ENOUGH} or more (bootstrap)."
    )
    if repeated:
        note += (
            f" {ONE_SEED.capitalize()} against {OTHER_SEEDS}: means over the seeds, each held"
            " against the mean of the rest; a prediction that does as well is worth a training of"
            " every set."
        )
    head += ("regret", "regret, 95 %")
    return Table("agreement", "Agreement of predictions", head, (*rows, *repeated), note)


def measured(findings: Findings) -> dict[str, float]:
    """Final returns by combination, with the main reward."""
    return {result.cameras: result.value.value for result in findings.ranked}


def repeats(against: str) -> str:
    """What one seed is held against, beside predictions of a measurement."""
    return OTHER_SEEDS if against == MEASURED else f"{OTHER_SEEDS}, {against}"


def list_name(members: frozenset[str]) -> str:
    """A list's name; that of one that is not the paper's is what is in it."""
    for name, own in paper.lists().items():
        if frozenset(own) == members:
            return LISTS[name]
    return ", ".join(label(cameras) for cameras in sorted(members))


def _sides(findings: Findings) -> list[tuple[Prediction, str, Mapping[str, float]]]:
    """Each prediction with what it is held against: what that is, and its values by set."""
    published = paper.measured()
    sides: list[tuple[Prediction, str, Mapping[str, float]]] = []
    if findings.study is not None:
        theirs = scored(PAPERS_MEASURED, published, paper.lists().values())
        for against, ours in (
            (MEASURED, measured(findings)),
            (MEASURED_SOON, middles(findings, TRAINING)),
        ):
            sides += [(one, against, ours) for one in (*findings.predictions, theirs)]
    sides += [(one, PAPERS_MEASURED, published) for one in findings.predictions]
    flown = [one for one in findings.predictions if one.who == IMITATION]
    for imitation in flown:
        values = {name: score for own in imitation.lists.values() for name, score in own.items()}
        sides += [(one, IMITATION, values) for one in findings.predictions if one not in flown]
    return sides


def _columns(findings: Findings) -> tuple[Prediction, ...]:
    """Predictions, then measurements, of which the paper's is always there."""
    lists = findings.lists.values()
    found = [*findings.predictions]
    if findings.study is not None:
        found.append(scored(MEASURED, measured(findings), lists, whole=False))
        soon = scored(MEASURED_SOON, middles(findings, TRAINING), lists, whole=False)
        found += [soon] if soon.lists else []
    return (*found, scored(PAPERS_MEASURED, paper.measured(), lists))


def _place(places: Mapping[str, float], cameras: str, of: int) -> str:
    """A place; among so many only, where not all of a list has one."""
    if cameras not in places:
        return ""
    return f"{places[cameras]:g}" + (f" of {len(places)}" if len(places) < of else "")


def _ordered(members: Iterable[str], shown: Iterable[Prediction]) -> list[str]:
    """By the last column that has all of them: as measured here, else in the paper."""
    chosen = tuple(members)
    ranked = {one.who: places for one in shown if len(places := one.places(chosen)) == len(chosen)}
    by = ranked.get(MEASURED) or next(iter(reversed(ranked.values())), {})
    return sorted(chosen, key=lambda cameras: (by.get(cameras, math.inf), cameras))


def _column(axes: Axes, x: int, places: Mapping[str, float], ordered: Sequence[str]) -> None:
    """The cells of one ranking, shaded from its best place to its worst."""
    for y, cameras in enumerate(ordered):
        if cameras not in places:
            axes.text(x, y, "–", ha="center", va="center", fontsize=6, color=FAINT)
            continue
        # Of a single place nobody can say whether it is good.
        last = len(places)
        better = (last - places[cameras]) / (last - 1) if last > 1 else 0.0
        left, right = x - 0.46, x + 0.46
        axes.fill_between([left, right], y - 0.44, y + 0.44, color=COLOURS[0], linewidth=0,
                          alpha=0.06 + 0.84 * better)  # fmt: skip
        said, ink = _place(places, cameras, len(ordered)), "white" if better > 0.45 else INK
        axes.text(x, y, said, ha="center", va="center", fontsize=6, color=ink)


def _repeated(findings: Findings, against: str) -> list[tuple[str, ...]]:
    """A row for each list that several seeds have ranked, and one for all."""
    found = repeat(findings, OURS[against])
    what = f"{ONE_SEED} against {repeats(against)}"
    rows = []
    for members, seeds in found.lists.items():
        rows.append((list_name(members), *_mean(seeds)))
    if len(found.lists) > 1:
        every = [one for seeds in found.lists.values() for one in seeds]
        rows.append(("all lists", *_mean(every)))
    return [(what, *row) for row in rows]


def _mean(found: Sequence[Agreement]) -> tuple[str, ...]:
    """Without p-values and intervals: the same seeds are on either side in turn."""
    return (
        _number(mean_known([one.tau for one in found])),
        "",
        "",
        _number(mean_known([one.rho for one in found])),
        "",
        f"{sum(one.top_hit for one in found)} of {len(found)}",
        f"{sum(one.bottom_hit for one in found)} of {len(found)}",
        f"{sum(one.regret for one in found) / len(found):.2f}",
        "",
    )


def _said(found: Agreement, over_seeds: Spread | None) -> tuple[str, ...]:
    return (
        _number(found.tau),
        _range(over_seeds.tau if over_seeds else None),
        *(_number(value) for value in (found.tau_p, found.rho, found.rho_p)),
        "yes" if found.top_hit else "no",
        "yes" if found.bottom_hit else "no",
        f"{found.regret:.2f}",
        _range(over_seeds.regret if over_seeds else None),
    )


def _together(found: Pooled, over_seeds: Spread | None) -> tuple[str, ...]:
    return (
        _number(found.tau),
        _range(over_seeds.tau if over_seeds else None),
        _probability(found.tau_p),
        _number(found.rho),
        _probability(found.rho_p),
        f"{found.top_hits} of {found.lists}",
        f"{found.bottom_hits} of {found.lists}",
        f"{found.regret:.2f}",
        _range(over_seeds.regret if over_seeds else None),
    )


def _range(interval: tuple[float, float] | None) -> str:
    return "" if interval is None else "{:.2f} to {:.2f}".format(*interval)


def _probability(value: float) -> str:
    return f"{value:.1g}" if value < 0.01 else _number(value)


def _number(value: float) -> str:
    return "undefined" if math.isnan(value) else f"{value:.2f}"
