"""The final value of a run: the one place that says what it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from needlehoop.study.data.records import FORMER_UNIT, HUMAN_RETURN, HUMAN_UNIT, Record

_TAIL = 0.1
"""Of an unfinished run's steps so far: its evaluations in this last share are averaged."""


@dataclass(frozen=True)
class Final:
    """Means over deterministic episodes that training does not see."""

    value: float
    """The return: the mean final potential."""
    human: float | None
    """What the human reward says of the same episodes; evaluations older than it have none."""
    human_unit: float | None
    """Its scene unit, m; ``None`` before the training is over."""
    success: float
    """Share of episodes that end with the task done."""
    cheat: float
    """Share that touched the goal without threading."""
    grasped: float | None
    """Share that held the needle at some time; ``None`` where it was not written down."""
    lifted: float | None
    """Share that brought it to the lift position."""
    area: float | None
    """Mean return over all of training: the area under its curve, by steps. ``None`` where
    training is not over, or has left no curve."""
    threading: float | None
    """The same of success, which compares across rewards whose points do not."""
    best: float | None
    """The highest success of an evaluation on the way or of the last: more than ``success`` is
    what training took away again. ``None`` where it is not over, or was not evaluated on the
    way."""
    episodes: int
    steps: int
    """Of training, when it was measured."""
    finished: bool
    """Whether the run's training was over."""


def final(run: Record) -> Final | None:
    """A run's final value; ``None`` where nothing has been evaluated.

    It is ``evaluation.json`` (100 episodes, written when training is done). Before that
    is there, or where it is older than the evaluations on the way, it is the mean over the
    rows of ``evaluations.csv`` in the last tenth of the steps so far, and not ``finished``.
    """
    rows, last = run.evaluations, run.evaluation
    newest = 0 if rows is None else int(rows["step"][-1])
    if last is not None and (run.finished or (last.get("steps_trained") or 0) >= newest):
        return Final(
            value=float(last["return"]),
            human=_told(last.get(HUMAN_RETURN)),
            human_unit=float(last.get(HUMAN_UNIT) or FORMER_UNIT),
            success=float(last["success"]),
            cheat=float(last["cheat"]),
            grasped=_told(last.get("grasped")),
            lifted=_told(last.get("lifted")),
            area=_area(run, "return"),
            threading=_area(run, "success"),
            best=_best(run),
            episodes=int(last["episodes"]),
            steps=_trained(run, last),
            finished=run.finished,
        )
    if rows is None:
        return None
    tail = rows["step"] > newest * (1.0 - _TAIL)
    episodes = rows["episodes"][tail]

    def mean(column: str) -> float:
        return float(np.average(rows[column][tail], weights=episodes))

    def known(column: str) -> float | None:
        return mean(column) if column in rows.columns else None

    return Final(
        value=mean("return"),
        human=known(HUMAN_RETURN),
        human_unit=None,
        success=mean("success"),
        cheat=mean("cheat"),
        grasped=known("grasped"),
        lifted=known("lifted"),
        area=None,
        threading=None,
        best=None,
        episodes=int(episodes.sum()),
        steps=newest,
        finished=False,
    )


def _area(run: Record, column: str) -> float | None:
    """Over buffers, which have as many steps each; in the first ones no episode may end."""
    if not run.finished or run.metrics is None or run.steps < run.planned_steps:
        return None
    values = run.metrics[column]
    return float(np.nanmean(values)) if not np.isnan(values).all() else None


def _best(run: Record) -> float | None:
    if not run.finished or run.evaluations is None or run.evaluation is None:
        return None
    return max(success for _, success in evaluations(run))


def evaluations(run: Record) -> list[tuple[int, float]]:
    """Environment steps and success of all that a run has been evaluated by, in their order.

    Those on the way, and ``evaluation.json``: where a run has gone on after it, it is not the last.
    """
    rows, last = run.evaluations, run.evaluation
    found = [] if rows is None else [*zip(rows["step"], rows["success"], strict=True)]
    if last is not None:
        found.append((_trained(run, last), last["success"]))
    return sorted((int(step), float(success)) for step, success in found)


def _trained(run: Record, last: Mapping[str, Any]) -> int:
    """Environment steps before ``evaluation.json``; older ones do not say, and close a run."""
    return int(last.get("steps_trained") or run.steps)


def _told(value: Any) -> float | None:
    return None if value is None else float(value)
