"""What disturbances cost camera sets, over their seeds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from needlehoop.study.data.contents import ALL, NONE, Stressed
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.statistics import SeedEstimate, rate

SEVERITY = 3
"""The severity that is summed up: what a lab or an operating room shows."""


@dataclass(frozen=True)
class Robustness:
    """Of one camera set with one reward, over the runs that were stressed."""

    result: Result
    success: dict[tuple[str, int], SeedEstimate]
    """By axis and severity, as far as all these runs were tested."""
    mean: SeedEstimate | None
    """Success at ``SEVERITY``, the mean over axes."""

    @property
    def name(self) -> str:
        """The cameras, and the label of runs that differ in another setting."""
        label = self.result.reward.partition("+")[2]
        return ", ".join(part for part in (self.result.cameras, label) if part)

    @property
    def undisturbed(self) -> SeedEstimate:
        """Success of the same episodes with nothing wrong."""
        return self.success[NONE, 0]

    @property
    def together(self) -> SeedEstimate | None:
        """Success with every axis at once."""
        return next((one for (axis, _), one in self.success.items() if axis == ALL), None)

    @property
    def axes(self) -> dict[str, SeedEstimate]:
        """Success at ``SEVERITY`` by axis, the worst first."""
        own = {
            axis: self.success[axis, level] for axis, level in self.success if _summed(axis, level)
        }
        return dict(sorted(own.items(), key=lambda item: item[1].value))


def _summed(axis: str, severity: int) -> bool:
    return severity == SEVERITY and axis not in (NONE, ALL)


def robustness(findings: StudyFindings) -> list[Robustness]:
    """Every camera set with a stressed run, the best mean at ``SEVERITY`` first."""
    found = []
    for result in findings.results:
        runs = [run.stress for run in result.runs if run.stress]
        by: defaultdict[tuple[str, int], list[Stressed]] = defaultdict(list)
        for row in chain(*runs):
            by[row.axis, row.severity].append(row)
        success = {key: _rate(own) for key, own in by.items() if len(own) == len(runs)}
        if (NONE, 0) not in success:
            continue
        shown = {key for key in success if _summed(*key)}
        axes = [own for run in runs if (own := [r for r in run if (r.axis, r.severity) in shown])]
        shares = [float(np.mean([row.success for row in own])) for own in axes]
        episodes = [sum(row.episodes for row in own) for own in axes]
        found.append(Robustness(result, success, rate(shares, episodes) if shares else None))
    return sorted(found, key=lambda one: -(one.mean.value if one.mean else 0.0))


def _rate(rows: Sequence[Stressed]) -> SeedEstimate:
    return rate([row.success for row in rows], [row.episodes for row in rows])
