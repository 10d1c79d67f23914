"""What it makes who writes a reward, and whether the writer was shown an image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import t as student

from needlehoop.study.data.combinations import HUMAN, label, reward_label
from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.report.table import Table
from needlehoop.study.stats.measures import CHEAT, HUMAN_POINTS, SUCCESS, THREADING, Measure, middle

_LEVEL = 0.95

_LEAST = 3
"""Pairs from which on there is an interval."""

_MEASURES = (HUMAN_POINTS, SUCCESS, THREADING, CHEAT)
"""What compares across rewards: a return does not, since each has points of its own."""

_IMAGES = (("vlm_img", "vlm_text"), ("vlm_img_claude", "vlm_text_claude"))
"""A writer that saw the first image, and the same one told by words alone."""

_COMPARED: Mapping[str, Sequence[tuple[str, str]]] = {
    **{
        f"{reward_label(reward)}, against {HUMAN}": [(reward, HUMAN)]
        for pair in _IMAGES
        for reward in reversed(pair)
    },
    **{f"{reward_label(seen)}, against text alone": [(seen, told)] for seen, told in _IMAGES},
    "an image, whoever writes": _IMAGES,
}
"""A row of the table, and which rewards it has against which others, of the same cameras."""


def writers(findings: Findings) -> Table:
    """A row for each comparison of rewards that some sets of cameras have been trained with.

    Differences are paired: of the same cameras with one reward and with the other, each by the
    middle of its seeds. Intervals are Student's over the pairs.
    """
    by_pair = {(one.cameras, one.reward): one for one in findings.results if one.finals}
    rows = []
    for name, compared in _COMPARED.items():
        pairs = [
            (result, by_pair[result.cameras, other])
            for reward, other in compared
            for result in by_pair.values()
            if result.reward == reward and (result.cameras, other) in by_pair
        ]
        if pairs:
            sets = sorted({label(result.cameras) for result, _ in pairs})
            cells = [_difference(pairs, measure) for measure in _MEASURES]
            rows.append((name, *cells, str(len(pairs)), ", ".join(sets)))
    head = ("reward", *(f"{one.name}: difference (95 %)" for one in _MEASURES))
    note = (
        "Differences between two rewards, paired by cameras; intervals are Student's over the"
        f" pairs, where there are {_LEAST} or more. {THREADING.name.capitalize()}: of all training"
        " episodes, so how soon the task is learnt. With one seed of each run an interval over few"
        " pairs holds luck as well."
    )
    return Table("writers", "Who writes the reward", (*head, "pairs", "cameras"), tuple(rows), note)


def _difference(pairs: Sequence[tuple[Result, Result]], measure: Measure) -> str:
    """The mean over the pairs; empty where one of them has no such number."""
    found = [[middle(one, measure) for one in pair] for pair in pairs]
    known = [(own, other) for own, other in found if own is not None and other is not None]
    if len(known) < len(pairs):
        return ""
    apart = np.array([own - other for own, other in known])
    form = f"+.{measure.digits}f"
    told = f"{apart.mean():{form}}"
    if len(apart) < _LEAST:
        return told
    error = float(apart.std(ddof=1)) / len(apart) ** 0.5
    half = error * float(student.ppf(0.5 + _LEVEL / 2, len(apart) - 1))
    return f"{told} ({apart.mean() - half:{form}} to {apart.mean() + half:{form}})"
