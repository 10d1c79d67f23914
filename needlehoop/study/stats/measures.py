"""What runs are judged by, and what the runs of a set of cameras gave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needlehoop.study.data.final import Final
from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.stats.statistics import iqm


@dataclass(frozen=True)
class Measure:
    """A number that a run ends with: higher is better, where nothing else is said."""

    name: str
    of: Callable[[Final], float | None]
    scale: float = 1.0
    """From a run's number to the one that is shown."""
    digits: int = 2


RETURN = Measure("return", lambda found: found.value)
"""Of the agent that training leaves."""

TRAINING = Measure("return over training", lambda found: found.area)
"""How soon it was learnt, and how well."""

SUCCESS = Measure("success, %", lambda found: found.success, 100.0, 0)

HUMAN_POINTS = Measure("human's points", lambda found: found.human)
"""What the human reward says of episodes, whichever reward they were learnt from."""

THREADING = Measure("threaded over training, %", lambda found: found.threading, 100.0, 0)
"""How soon it was learnt, whatever a reward's points."""

BEST = Measure("success at best, %", lambda found: found.best, 100.0, 0)
"""What an agent could do once, whether or not it still can."""

CHEAT = Measure("cheat, %", lambda found: found.cheat, 100.0, 0)
"""Lower is better."""


def values(result: Result, measure: Measure) -> list[float]:
    """Of each run; empty where one has no such number."""
    known = [one for found in result.finals if (one := measure.of(found)) is not None]
    return [measure.scale * one for one in known] if len(known) == len(result.finals) else []


def middle(result: Result, measure: Measure) -> float | None:
    """The interquartile mean over seeds; ``None`` where a run has no such number."""
    own = values(result, measure)
    return float(iqm(np.array(own))) if own else None


def by_set(findings: Findings, measure: Measure) -> dict[str, list[float]]:
    """The runs' numbers with the main reward, by set of cameras, the best final return first.

    Sets of which a run has no such number are not there.
    """
    every = {result.cameras: values(result, measure) for result in findings.ranked}
    return {cameras: own for cameras, own in every.items() if own}


def middles(findings: Findings, measure: Measure) -> dict[str, float]:
    """The same sets' interquartile means over seeds."""
    return {name: float(iqm(np.array(own))) for name, own in by_set(findings, measure).items()}


def by_seed(findings: Findings, measure: Measure) -> dict[str, dict[int, float]]:
    """The same run by run: by set of cameras, then by seed."""
    return {
        result.cameras: dict(zip((run.place.seed for run in result.runs), own, strict=True))
        for result in findings.ranked
        if (own := values(result, measure))
    }
