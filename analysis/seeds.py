"""What seeds say: how much of a number is luck, and which camera sets can be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import f_oneway, tukey_hsd

from needlehoop.study.render.table import Cell, Column, Estimated, Table
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.run import RETURN, SUCCESS, TRAINING, Measure
from needlehoop.study.stats.statistics import Interval

LEAST = 2
"""Seeds of a camera set from which on they say how far its runs lie apart."""

BEST, LEVEL, WORSE = "the best", "cannot be told from it", "worse"

_RELIABLE = 0.8
"""Share of the variance of means over seeds that is to be the cameras'."""

_TAILS = (0.025, 0.975)


def luck(findings: StudyFindings) -> Table:
    """A row for each measure: how much camera sets differ, and how much seeds of one."""
    rows = []
    for measure in (RETURN, SUCCESS, TRAINING):
        groups = [*_repeated(findings, measure).values()]
        within = _deviation(groups)
        if len(groups) < 2 or within == 0.0:
            continue
        share, interval, p = _share(groups)
        between = math.sqrt(share / (1.0 - share)) * within if share > 0.0 else 0.0
        # Rows have units of their own.
        number = Column.of(measure).text
        seeds = sorted({len(group) for group in groups})
        rows.append(
            (
                measure.heading,
                number(between),
                number(within),
                max(share, 0.0),
                interval,
                p,
                _enough(share),
                f"{len(groups)}, {' to '.join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))}",
            )
        )
    columns = (
        Column("of"), Column("sd between sets"), Column("sd between seeds of a set"),
        Column.share("the cameras' share"), Column("95 %", form=".0f", scale=100.0),
        Column("p", form="p"), Column("seeds needed"), Column("sets, seeds"),
    )  # fmt: skip
    note = (
        "Of the variance of single runs, the share that is the cameras' and not the seed's"
        " (intraclass correlation, one-way random effects), and p of none: by F, which takes all"
        f" sets to vary alike. Seeds needed: for means of which {100 * _RELIABLE:.0f} % of the"
        " variance is the cameras'. Sets of two seeds or more."
    )
    return Table("luck", "Cameras or luck?", columns, tuple(rows), note)


def apart(findings: StudyFindings) -> Table:
    """Each camera set's difference from the best one, and whether it can be told from chance."""
    measures = (RETURN, TRAINING)
    found = [_from_the_best(findings, measure) for measure in measures]
    rows = [
        (
            one.cameras,
            *(cell for own in found for cell in own.get(one.cameras, (None, None, None))),
            len(one.finals),
        )
        for one in findings.ranked
        if any(one.cameras in own for own in found)
    ]
    columns = [Column("cameras")]
    for measure, before in zip(measures, ("", "over training: "), strict=True):
        columns += [
            Column.of(measure),
            Column(f"{before}from the best, 95 %", form="+.2f"),
            Column(f"{before}which is"),
        ]
    note = (
        "Means over seeds. Intervals are Tukey's: right for all pairs of sets at once, however the"
        " best was found; how far seeds lie apart is pooled over the sets."
    )
    title = "Which can be told from the best"
    return Table("apart", title, (*columns, Column("seeds")), tuple(rows), note)


def _from_the_best(findings: StudyFindings, measure: Measure) -> dict[str, tuple[Cell, ...]]:
    """By camera set: its mean, the difference with its interval, and what that says."""
    groups = _repeated(findings, measure)
    if len(groups) < 2 or _deviation([*groups.values()]) == 0.0:
        return {}
    tukey = tukey_hsd(*groups.values())
    limits = tukey.confidence_interval()
    means = [float(np.mean(own)) for own in groups.values()]
    best = int(np.argmax(means))
    found: dict[str, tuple[Cell, ...]] = {}
    for i, cameras in enumerate(groups):
        interval = Interval(float(limits.low[i, best]), float(limits.high[i, best]))
        difference = Estimated(float(tukey.statistic[i, best]), interval)
        said = (None, BEST) if i == best else (difference, LEVEL if interval.high >= 0 else WORSE)
        found[cameras] = (means[i], *said)
    return found


def _repeated(findings: StudyFindings, measure: Measure) -> dict[str, list[float]]:
    """The runs' numbers of camera sets with several, the best final return first."""
    every = findings.by_set(measure)
    return {cameras: own for cameras, own in every.items() if len(own) >= LEAST}


def _deviation(groups: Sequence[Sequence[float]]) -> float:
    """Standard deviation of a run about its camera set's mean, pooled; 0 where there is none."""
    free = sum(len(group) - 1 for group in groups)
    return math.sqrt(sum(np.var(group) * len(group) for group in groups) / free) if free else 0.0


def _share(groups: Sequence[Sequence[float]]) -> tuple[float, Interval, float]:
    """The intraclass correlation, its 95 % interval (no end below 0), and p of none, by F."""
    sizes = np.array([len(group) for group in groups], dtype=float)
    free = len(groups) - 1
    free_within = int(sizes.sum()) - len(groups)
    # What stands for the number of seeds where sets have unlike numbers of them.
    seeds = float((sizes.sum() - (sizes**2).sum() / sizes.sum()) / free)
    ratio, p = f_oneway(*groups)
    low, high = (
        ratio / fisher.ppf(_TAILS[1], free, free_within),
        ratio * fisher.ppf(_TAILS[1], free_within, free),
    )
    share, low, high = (float((one - 1.0) / (one + seeds - 1.0)) for one in (ratio, low, high))
    return share, Interval(max(low, 0.0), max(high, 0.0)), float(p)


def _enough(share: float) -> int | str:
    """Seeds for reliable means (Spearman and Brown's formula)."""
    if share <= 0.0:
        return "no number"
    return math.ceil(_RELIABLE * (1.0 - share) / ((1.0 - _RELIABLE) * share))
