"""How far episodes come: where a set of cameras fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from needlehoop.study.data.combinations import label, reward_label
from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.report.table import Table

_FINE = 0.95
"""Success from which on a set of cameras does not fail."""

_PAST = 0.05
"""Share of episodes in which the needle may be threaded without having been lifted first."""


@dataclass(frozen=True)
class Reached:
    """Shares of a result's episodes, means over its seeds."""

    grasped: float
    lifted: float | None
    """``None`` where a run under the same reward goes to the hoop past the lift position."""
    threaded: float

    @property
    def fails_in(self) -> str:
        """The phase in which most episodes end; empty where next to none fail."""
        if self.threaded >= _FINE:
            return ""
        stages = {"grasp": (1.0, self.grasped)}
        if self.lifted is None:
            stages["carry and insert"] = (self.grasped, self.threaded)
        else:
            stages |= {"lift": (self.grasped, self.lifted), "insert": (self.lifted, self.threaded)}
        return max(stages, key=lambda name: stages[name][0] - stages[name][1])


def reached(findings: Findings) -> dict[tuple[str, str], Reached]:
    """How far each set came with each reward, where its evaluations say so."""
    shares = {(r.cameras, r.reward): found for r in findings.results if (found := _shares(r))}
    past = {
        reward for (_, reward), (_, lifted, threaded) in shares.items() if threaded > lifted + _PAST
    }
    return {
        place: Reached(grasped, None if place[1] in past else lifted, threaded)
        for place, (grasped, lifted, threaded) in shares.items()
    }


def phases(findings: Findings) -> Table:
    """A row for each set of cameras and reward, in the order of results."""
    known = reached(findings)
    rows = []
    for result in findings.results:
        if (found := known.get((result.cameras, result.reward))) is None:
            continue
        lifted = "" if found.lifted is None else f"{100 * found.lifted:.0f}"
        rows.append(
            (
                label(result.cameras),
                f"{100 * found.grasped:.0f}",
                lifted,
                f"{100 * found.threaded:.0f}",
                found.fails_in,
                reward_label(result.reward),
                str(result.value.seeds),
            )
        )
    head = ("cameras", "grasped, %", "lifted, %", "threaded, %", "fails in", "reward", "seeds")
    note = (
        "Shares of final episodes, means over seeds. Fails in: the phase in which most episodes"
        f" end, where less than {100 * _FINE:.0f} % are threaded."
    )
    if any(found.lifted is None for found in known.values()):
        note += (
            " Lifted is left empty under a reward that lets the needle go to the hoop past the"
            " lift position; there, carrying and inserting are one phase."
        )
    return Table("phases", "Where they fail", head, tuple(rows), note)


def _shares(result: Result) -> tuple[float, float, float] | None:
    grasped = [found.grasped for found in result.finals if found.grasped is not None]
    lifted = [found.lifted for found in result.finals if found.lifted is not None]
    if not result.finals or not len(grasped) == len(lifted) == len(result.finals):
        return None
    return _mean(grasped), _mean(lifted), _mean([found.success for found in result.finals])


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
