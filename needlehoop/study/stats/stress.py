"""What disturbances cost camera sets, over their seeds."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from needlehoop.study.data.contents import ALL, NONE
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
            axis: one
            for (axis, severity), one in self.success.items()
            if severity == SEVERITY and axis not in (NONE, ALL)
        }
        return dict(sorted(own.items(), key=lambda item: item[1].value))

    @property
    def mean(self) -> SeedEstimate | None:
        """Success at ``SEVERITY``, the mean over axes."""
        shares, episodes = [], []
        for run in self.result.runs:
            own = [row for row in run.stress if row.axis in self.axes and row.severity == SEVERITY]
            if own:
                shares.append(float(np.mean([row.success for row in own])))
                episodes.append(sum(row.episodes for row in own))
        return rate(shares, episodes) if shares else None


def robustness(findings: StudyFindings) -> list[Robustness]:
    """Every camera set with a stressed run, the best mean at ``SEVERITY`` first."""
    found = [one for result in findings.results if (one := _of(result)) is not None]
    return sorted(found, key=lambda one: -(one.mean.value if one.mean else 0.0))


def _of(result: Result) -> Robustness | None:
    runs = [run for run in result.runs if run.stress]
    by: defaultdict[tuple[str, int], list[tuple[float, int]]] = defaultdict(list)
    for run in runs:
        for row in run.stress:
            by[row.axis, row.severity].append((row.success, row.episodes))
    whole = {
        key: rate([share for share, _ in own], [n for _, n in own])
        for key, own in by.items()
        if len(own) == len(runs)
    }
    return Robustness(result, whole) if (NONE, 0) in whole else None
