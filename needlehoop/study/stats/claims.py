"""What the paper says of cameras, one comparison at a time, and what became of it here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needlehoop.study.data import paper
from needlehoop.study.data.combinations import label
from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.report.table import Table
from needlehoop.study.stats.luck import LEAST, Noise, noise
from needlehoop.study.stats.measures import RETURN, SUCCESS, TRAINING, Measure, values
from needlehoop.study.stats.statistics import iqm, no_interval


@dataclass(frozen=True)
class Claim:
    """That some sets of cameras do better than others: by the mean of each side's returns."""

    text: str
    better: tuple[str, ...]
    worse: tuple[str, ...]


_COLOUR = ("rgb_front+rgb_side",)
_DEPTH = ("dep_front+rgb_side", "rgb_front+dep_side")
_SEGMENTATION = ("rgb_front+seg_side", "seg_front+rgb_side")
_SAME = ("dep_front+dep_side", "seg_front+seg_side")
_BEST, _REVERSED = ("dep_front+seg_side",), ("seg_front+dep_side",)
_SINGLE = ("rgb_default", "dep_default", "seg_default")

CLAIMS = (
    Claim(
        "front and side views together beat single cameras",
        (*_COLOUR, *_DEPTH, *_SEGMENTATION, *_SAME, *_BEST, *_REVERSED),
        _SINGLE,
    ),
    Claim("depth beside colour beats colour alone", _DEPTH, _COLOUR),
    Claim("depth is better in front than at the side", _DEPTH[:1], _DEPTH[1:]),
    Claim(
        "depth beside colour wants two views, not one twice", _DEPTH, ("rgb_default+dep_default",)
    ),
    Claim("segmentation beside colour beats colour alone", _SEGMENTATION, _COLOUR),
    Claim("segmentation is better at the side than in front", _SEGMENTATION[:1], _SEGMENTATION[1:]),
    Claim(
        "segmentation beside colour helps even from one view",
        ("rgb_default+seg_default",),
        ("rgb_default",),
    ),
    Claim("depth in front with segmentation at the side beats the reverse", _BEST, _REVERSED),
    Claim("depth with segmentation beats two of the same", _BEST, _SAME),
    Claim("one segmentation camera beats one of colour", ("seg_default",), ("rgb_default",)),
)
"""Of the paper's discussion of its camera combinations (section V), in its order."""


def claims(findings: Findings) -> Table:
    """A row for each claim whose sets have all been trained with the main reward."""
    results = {result.cameras: result for result in findings.ranked if result.finals}
    published = paper.measured()
    within = {measure: noise(findings, measure) for measure in (RETURN, TRAINING)}
    rows = []
    for claim in CLAIMS:
        if not {*claim.better, *claim.worse} <= set(results):
            continue
        better, worse = ([results[name] for name in s] for s in (claim.better, claim.worse))
        theirs = [_mean([published[name] for name in s]) for s in (claim.better, claim.worse)]
        rows.append(
            (
                claim.text,
                " against ".join(_named(side) for side in (claim.better, claim.worse)),
                _pair(theirs, "{:.2f}"),
                _pair(_means((better, worse), RETURN), "{:.2f}"),
                *_judged(better, worse, RETURN, within[RETURN]),
                _pair(_means((better, worse), SUCCESS), "{:.0f}"),
                *_judged(better, worse, TRAINING, within[TRAINING]),
            )
        )
    head = ("the paper says", "cameras", "its returns", "returns here", "difference, 95 %", "here")
    note = (
        "Means of each side's sets. Holds, or reversed: by the interval, where every set has"
        f" {LEAST} seeds or more (Student's; how far seeds lie apart is pooled over all sets of the"
        " study); by the difference alone where there are fewer, and then it may be luck. The"
        " paper has one run of each set."
    )
    head += ("threaded, %", f"{TRAINING.name}: difference, 95 %", "here, over training")
    return Table("claims", "What of the paper holds here", head, tuple(rows), note)


def _judged(
    better: Sequence[Result], worse: Sequence[Result], measure: Measure, within: Noise | None
) -> tuple[str, str]:
    """The difference of two sides with its interval, and what it says of the claim."""
    if not all(values(one, measure) for one in (*better, *worse)):
        return "", ""
    value, other = _means((better, worse), measure)
    difference, runs = value - other, [len(one.finals) for one in (*better, *worse)]
    if within is None or min(runs) < LEAST:
        level = f"{difference:.2f}".lstrip("-") == "0.00"
        verdict = "no difference" if level else "holds" if value > other else "reversed"
        return f"{difference:+.2f}", f"{verdict}; {no_interval(min(runs))}"
    weights = [1 / len(better)] * len(better) + [-1 / len(worse)] * len(worse)
    half = within.half_width(weights, runs)
    low, high = difference - half, difference + half
    verdict = "holds" if low > 0 else "reversed" if high < 0 else "cannot be told"
    return f"{difference:+.2f} ({low:+.2f} to {high:+.2f})", verdict


def _means(sides: Sequence[Sequence[Result]], measure: Measure) -> list[float]:
    """Of each side's sets, interquartile means over their seeds."""
    return [_mean([float(iqm(np.array(values(one, measure)))) for one in side]) for side in sides]


def _named(side: Sequence[str]) -> str:
    """Two sets by name; of more, how many of what."""
    if len(side) > 2:
        return f"{len(side)} {'pairs' if all('+' in name for name in side) else 'single cameras'}"
    return ", ".join(label(name) for name in side)


def _pair(sides: Sequence[float], form: str) -> str:
    return " / ".join(form.format(value) for value in sides)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
