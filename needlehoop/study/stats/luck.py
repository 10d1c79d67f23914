"""How much of what a study measured is its cameras', and how much its seeds'."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import studentized_range
from scipy.stats import t as student

from needlehoop.study.data.combinations import label
from needlehoop.study.data.findings import Findings
from needlehoop.study.report.table import Table
from needlehoop.study.stats.measures import RETURN, SUCCESS, TRAINING, Measure, by_set

_LEVEL = 0.95

_RELIABLE = 0.8
"""Of means over seeds: the share of their variance that is the cameras'."""

LEAST = 2
"""Seeds of a set from which on they say how far runs of one set lie apart."""

BEST, LEVEL, WORSE = "the best", "cannot be told from it", "worse"


@dataclass(frozen=True)
class Noise:
    """How far runs of one set of cameras lie apart: pooled over all sets of a study.

    Of three seeds alone nobody can tell how much a set varies. Of all sets' together one can, if
    they vary alike.
    """

    deviation: float
    """Standard deviation of a run's return."""
    free: int
    """Degrees of freedom."""

    def half_width(self, weights: Sequence[float], runs: Sequence[int]) -> float:
        """Of the 95 % interval of a weighted sum of sets' means.

        Args:
            weights: of each set's mean.
            runs: of each set.
        """
        size = math.sqrt(sum(w * w / n for w, n in zip(weights, runs, strict=True)))
        return self.deviation * size * float(student.ppf(0.5 + _LEVEL / 2, self.free))

    def half_width_of_any(self, sets: int, runs: tuple[int, int]) -> float:
        """The same of the difference of any two among ``sets``, all of them at once (Tukey's)."""
        size = math.sqrt(sum(1.0 / n for n in runs) / 2.0)
        return self.deviation * size * _studentized(sets, self.free)


def noise(findings: Findings, measure: Measure) -> Noise | None:
    """The noise of single runs with the main reward; ``None`` where no set has two seeds."""
    return _pooled([*_repeated(findings, measure).values()])


def luck(findings: Findings) -> Table:
    """A row for each measure: how much sets differ, and how much seeds of one."""
    rows = []
    for measure in (RETURN, SUCCESS, TRAINING):
        groups = [*_repeated(findings, measure).values()]
        within = _pooled(groups)
        if within is None or len(groups) < 2 or within.deviation == 0.0:
            continue
        share, low, high, p = _share(groups, within)
        between = math.sqrt(share / (1.0 - share)) * within.deviation if share > 0.0 else 0.0
        rows.append(
            (
                measure.name,
                f"{between:.{measure.digits}f}",
                f"{within.deviation:.{measure.digits}f}",
                f"{100 * max(share, 0.0):.0f}",
                f"{100 * max(low, 0.0):.0f} to {100 * max(high, 0.0):.0f}",
                f"{p:.1g}" if p < 0.01 else f"{p:.2f}",
                str(_enough(share)),
                f"{len(groups)}, {_span([len(group) for group in groups])}",
            )
        )
    head = ("of", "sd between sets", "sd between seeds of a set", "the cameras' share, %", "95 %")
    note = (
        "Of the variance of single runs, the share that is the cameras' and not the seed's"
        " (intraclass correlation, one-way random effects), and p of none: by F, which takes all"
        f" sets to vary alike. Seeds needed: for means of which {100 * _RELIABLE:.0f} % of the"
        " variance is the cameras'. Sets of two seeds or more."
    )
    head += ("p", "seeds needed", "sets, seeds")
    return Table("luck", "Cameras or luck?", head, tuple(rows), note)


def apart(findings: Findings) -> Table:
    """Each set's difference from the best one, and whether it can be told from chance."""
    found = [_from_the_best(findings, measure) for measure in (RETURN, TRAINING)]
    rows = []
    for result in findings.ranked:
        cells = [own.get(result.cameras, ("", "", "")) for own in found]
        if any(map(any, cells)):
            rows.append((label(result.cameras), *cells[0], *cells[1], str(len(result.finals))))
    head = ("cameras", RETURN.name, "from the best, 95 %", "which is", TRAINING.name)
    head += ("over training: from the best, 95 %", "over training: which is")
    note = (
        "Means over seeds. Intervals are Tukey's: right for all pairs of sets at once, however the"
        " best was found; how far seeds lie apart is pooled over the sets."
    )
    title = "Which can be told from the best"
    return Table("apart", title, (*head, "seeds"), tuple(rows), note)


def _from_the_best(findings: Findings, measure: Measure) -> dict[str, tuple[str, str, str]]:
    """By set: its mean, the difference with its interval, and what that says."""
    groups = _repeated(findings, measure)
    within = _pooled([*groups.values()])
    if within is None or within.deviation == 0.0 or len(groups) < 2:
        return {}
    means = {cameras: float(np.mean(own)) for cameras, own in groups.items()}
    best = max(means, key=means.__getitem__)
    found = {}
    for cameras, mean in means.items():
        runs = (len(groups[cameras]), len(groups[best]))
        half = within.half_width_of_any(len(groups), runs)
        difference = mean - means[best]
        told = f"{difference:+.2f} ({difference - half:+.2f} to {difference + half:+.2f})"
        said = LEVEL if difference + half >= 0.0 else WORSE
        found[cameras] = (f"{mean:.2f}", *(("", BEST) if cameras == best else (told, said)))
    return found


def _repeated(findings: Findings, measure: Measure) -> dict[str, list[float]]:
    """The runs' numbers of sets with several, the best final return first."""
    every = by_set(findings, measure)
    return {cameras: own for cameras, own in every.items() if len(own) >= LEAST}


def _pooled(groups: Sequence[Sequence[float]]) -> Noise | None:
    free = sum(len(group) - 1 for group in groups)
    if free < 1:
        return None
    squares = sum(float(np.var(group)) * len(group) for group in groups)
    return Noise(math.sqrt(squares / free), free)


def _share(groups: Sequence[Sequence[float]], within: Noise) -> tuple[float, float, float, float]:
    """The intraclass correlation, its 95 % interval, and p of none, by F."""
    sizes = np.array([len(group) for group in groups], dtype=float)
    means = np.array([np.mean(group) for group in groups])
    middle = float((sizes * means).sum() / sizes.sum())
    free = len(groups) - 1
    between = float((sizes * (means - middle) ** 2).sum()) / free
    # What stands for the number of seeds where sets have unlike numbers of them.
    seeds = float((sizes.sum() - (sizes**2).sum() / sizes.sum()) / free)
    ratio = between / within.deviation**2
    high_f = ratio * float(fisher.ppf(0.5 + _LEVEL / 2, within.free, free))
    low_f = ratio / float(fisher.ppf(0.5 + _LEVEL / 2, free, within.free))
    share, low, high = ((one - 1.0) / (one + seeds - 1.0) for one in (ratio, low_f, high_f))
    return share, low, high, float(fisher.sf(ratio, free, within.free))


def _enough(share: float) -> int | str:
    """Seeds for reliable means (Spearman and Brown's formula)."""
    if share <= 0.0:
        return "no number"
    return math.ceil(_RELIABLE * (1.0 - share) / ((1.0 - _RELIABLE) * share))


def _span(numbers: Sequence[int]) -> str:
    fewest, most = min(numbers), max(numbers)
    return str(fewest) if fewest == most else f"{fewest} to {most}"


@cache
def _studentized(sets: int, free: int) -> float:
    return float(studentized_range.ppf(_LEVEL, sets, free))
