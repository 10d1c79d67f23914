"""What one run comes to: its final value, its evaluations, and how far its training was when."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from needlehoop.study.data.records import HUMAN_RETURN, Record

BUFFERS = 5
"""Buffers of training over which a share of episodes is taken."""

_TAIL = 0.1
"""Share of an unfinished run's steps so far: evaluations in its last tenth are averaged."""

_POINTS = 120
_WINDOW = 0.04
"""Width of the moving mean over training, as a share of the longest run."""


@dataclass(frozen=True)
class Final:
    """Means over deterministic episodes that training does not see."""

    value: float
    """The return: the mean final potential."""
    human: float | None
    """What the human reward says of the same episodes; ``None`` where it was not written down."""
    shares: Mapping[str, float]
    """Shares of episodes, by the task's columns: success, cheat, and each fact."""
    episodes: int
    finished: bool
    area: float | None
    """Mean return over all of training: the area under its curve, by steps. ``None`` where
    training is not over, or has left no curve."""
    success_area: float | None
    """The same of success, which compares across rewards, unlike their points."""
    best: float | None
    """The highest success of all evaluations; more than ``success`` is what training took away
    again. ``None`` where training is not over, or was not evaluated on the way."""

    @property
    def success(self) -> float:
        """Share of episodes that end with the task done."""
        return self.shares["success"]

    @property
    def cheat(self) -> float | None:
        """Share of episodes that look done and are not; ``None`` where a task has no such thing."""
        return self.shares.get("cheat")


@dataclass(frozen=True)
class Measure:
    """A number that a run ends with; higher is better unless it says otherwise."""

    name: str
    of: Callable[[Final], float | None]
    unit: str = ""
    digits: int = 2


RETURN = Measure("return", lambda found: found.value)
"""Return of the agent that training leaves."""

TRAINING = Measure("return over training", lambda found: found.area)
"""How soon the task was learnt, and how well."""

SUCCESS = Measure("success", lambda found: found.success, "%", 0)

HUMAN_POINTS = Measure("human's points", lambda found: found.human)
"""What the human reward says of episodes, whichever reward they were learnt from."""

SUCCESS_OVER_TRAINING = Measure("success over training", lambda found: found.success_area, "%", 0)
"""How soon the task was learnt, whatever a reward's points."""

BEST = Measure("success at best", lambda found: found.best, "%", 0)
"""What an agent could do once, whether or not it still can."""

CHEAT = Measure("cheat", lambda found: found.cheat, "%", 0)
"""Lower is better."""


def final(run: Record) -> Final | None:
    """A run's final value; ``None`` where nothing has been evaluated.

    It is ``evaluation.json`` (100 episodes, written when training is done). Before that
    file exists, or where it is older than the evaluations on the way, it is the mean over the
    rows of ``evaluations.csv`` in the last tenth of the steps so far, and not ``finished``.
    """
    rows, last = run.evaluations, run.evaluation
    newest = 0 if rows is None else int(rows["step"][-1])
    if last is not None and (run.finished or _trained(run) >= newest):
        said, finished = last, run.finished
    elif rows is not None:
        tail = rows["step"] > newest * (1.0 - _TAIL)
        episodes = rows["episodes"][tail]
        said = {name: np.average(own[tail], weights=episodes) for name, own in rows.items()}
        said["episodes"], finished = episodes.sum(), False
    else:
        return None
    tried = run.finished and rows is not None and last is not None
    return Final(
        value=float(said["return"]),
        human=said.get(HUMAN_RETURN),
        shares={name: float(said[name]) for name in run.task.columns},
        area=_over_training(run, "return"),
        success_area=_over_training(run, "success"),
        best=max(success for _, success in evaluations(run)) if tried else None,
        episodes=int(said["episodes"]),
        finished=finished,
    )


def evaluations(run: Record) -> list[tuple[int, float]]:
    """Environment steps and success of all evaluations of a run, in their order.

    These are the ones on the way, and ``evaluation.json``, which is not the last where a run has
    gone on after it.
    """
    rows, last = run.evaluations, run.evaluation
    found = [] if rows is None else [*zip(rows["step"], rows["success"], strict=True)]
    if last is not None:
        found.append((_trained(run), last["success"]))
    return sorted((int(step), float(success)) for step, success in found)


def has_curve(run: Record) -> bool:
    """Whether at least one of its episodes ended."""
    return run.metrics is not None and not np.isnan(run.metrics["return"]).all()


def grid_of(runs: Iterable[Record]) -> np.ndarray:
    """Steps for the curves of runs, some with metrics, from 0 to what the longest has."""
    own = list(runs)
    # No more points than buffers, or a short run's line has stairs.
    buffers = max(len(run.metrics["step"]) for run in own if run.metrics is not None)
    return np.linspace(0, max(run.steps for run in own), min(_POINTS, buffers) + 1)


def smooth(run: Record, steps: np.ndarray, column: str) -> np.ndarray:
    """A column of a run on a grid of steps, as a moving mean; NaN beyond what the run has.

    Buffers in which no episode ended have no values.
    """
    return _moving_mean(run, column, steps, _WINDOW * steps[-1])


def share_at(run: Record, steps: np.ndarray, column: str) -> np.ndarray:
    """A column of ``metrics.csv`` on a grid of steps, as the mean over ``BUFFERS`` buffers."""
    return _moving_mean(run, column, steps, (BUFFERS - 0.5) * run.buffer)


def steps_to_share(run: Record, column: str, share: float) -> float | None:
    """Environment steps until a share of training episodes is first reached, if ever."""
    steps = np.array([]) if run.metrics is None else run.metrics["step"]
    # Before that, the mean is of too few episodes.
    hits = np.flatnonzero(share_at(run, steps, column)[BUFFERS - 1 :] >= share)
    return float(steps[BUFFERS - 1 + hits[0]]) if len(hits) else None


def _moving_mean(run: Record, column: str, steps: np.ndarray, window: float) -> np.ndarray:
    """The mean of a column over ``window`` steps before each of ``steps`` ``(points,)``.

    NaN where there is nothing to take it of.
    """
    if run.metrics is None or column not in run.metrics:
        return np.full(len(steps), np.nan)
    at, values = run.metrics["step"], run.metrics[column]
    known = ~np.isnan(values)
    at, values = at[known], values[known]
    sums = np.concatenate([[0.0], np.cumsum(values)])
    first = np.searchsorted(at, steps - window, side="right")
    last = np.searchsorted(at, steps, side="right")
    count = last - first
    with np.errstate(invalid="ignore"):
        means = (sums[last] - sums[first]) / np.where(count > 0, count, np.nan)
    return np.where(steps <= at[-1] if len(at) else False, means, np.nan)


def _over_training(run: Record, column: str) -> float | None:
    """The mean over buffers, all of as many steps; in the first ones no episode may end."""
    if not run.finished or run.metrics is None or run.steps < run.planned_steps:
        return None
    values = run.metrics[column]
    return float(np.nanmean(values)) if not np.isnan(values).all() else None


def _trained(run: Record) -> int:
    """Environment steps before ``evaluation.json``; one that does not say so closes a run."""
    assert run.evaluation is not None
    return int(run.evaluation.get("steps_trained", run.steps))
