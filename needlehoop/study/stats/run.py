"""The numbers of one run: its final value, its evaluations, and its progress in training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from needlehoop.study.data.records import Record

RETURN, SUCCESS, CHEAT = "return", "success", "cheat"
"""Means over final episodes: the return in the reward's own points, and two of the task's facts."""
HUMAN_POINTS = "human's points"
"""What the human reward says of final episodes, whichever reward they were learnt from."""
TRAINING, SUCCESS_OVER_TRAINING = "return over training", "success over training"
"""Means over all buffers of a training that is over: how soon the task was learnt, and how well.
Success compares across rewards, unlike their points."""
BEST = "success at best"
"""The highest success of all evaluations: what training may have taken away again."""

BUFFERS = 5
"""Buffers of training over which a share of episodes is taken."""

_TAIL = 0.1
"""Share of an unfinished run's steps so far: evaluations in its last tenth are averaged."""

_WINDOW = 0.04
"""Width of the moving mean over training, as a share of the longest run."""


@dataclass(frozen=True)
class Final:
    """Means over episodes of the mean action, which training does not see."""

    measures: Mapping[str, float]
    """Shares of episodes by fact, and the numbers named above, as far as a run has them."""
    episodes: int
    finished: bool


def final(run: Record) -> Final | None:
    """A run's final value; ``None`` where nothing has been evaluated.

    It is ``evaluation.json`` (100 episodes, written when training is done). Before that
    file exists, or where it is older than the evaluations on the way, it is the mean over the
    rows of ``evaluations.csv`` in the last tenth of the steps so far, and not ``finished``.
    """
    rows, last = run.evaluations, run.evaluation
    newest = 0 if rows is None else int(max(rows["step"]))
    if last is not None and (run.finished or last["steps_trained"] >= newest):
        means, finished = dict(last), run.finished
    elif rows is not None:
        tail = rows[rows["step"] > newest * (1.0 - _TAIL)]
        means = {name: np.average(tail[name], weights=tail["episodes"]) for name in tail}
        means["episodes"], finished = np.sum(tail["episodes"]), False
    else:
        return None
    measures = {name: means[name] for name in run.task.columns} | {
        RETURN: means["return"],
        HUMAN_POINTS: means.get("return_human"),
        TRAINING: _over_training(run, "return"),
        SUCCESS_OVER_TRAINING: _over_training(run, "success"),
    }
    if run.finished and rows is not None and last is not None:
        measures[BEST] = max(success for _, success in evaluations(run))
    known = {name: float(value) for name, value in measures.items() if value is not None}
    return Final(known, int(means["episodes"]), finished)


def evaluations(run: Record) -> list[tuple[int, float]]:
    """Environment steps and success of all evaluations of a run, in their order.

    These are the ones on the way, and ``evaluation.json``, which is not the last where a run has
    gone on after it.
    """
    rows, last = run.evaluations, run.evaluation
    pairs = [] if rows is None else [*zip(rows["step"], rows["success"], strict=True)]
    if last is not None:
        pairs.append((last["steps_trained"], last["success"]))
    return sorted((int(step), float(success)) for step, success in pairs)


def has_curve(run: Record) -> bool:
    """Whether at least one of its episodes ended."""
    return run.metrics is not None and bool(run.metrics["return"].notna().any())


def smooth(run: Record, steps: np.ndarray, column: str) -> np.ndarray:
    """A column of ``metrics.csv`` on a grid of steps, as a moving mean over 4 % of the grid.

    NaN beyond what the run has. Buffers in which no episode ended have no values.
    """
    assert run.metrics is not None
    window = max(1, round(_WINDOW * steps[-1] / run.buffer))
    values = run.metrics[column].rolling(window, min_periods=1).mean()
    return np.interp(steps, run.metrics["step"], values, left=np.nan, right=np.nan)


def steps_to_success(run: Record, share: float) -> float | None:
    """Environment steps until a share of training episodes first succeeds over ``BUFFERS``."""
    if run.metrics is None:
        return None
    means = run.metrics["success"].rolling(BUFFERS, min_periods=1).mean().to_numpy()
    # Earlier means are of too few episodes.
    hits = np.flatnonzero(means[BUFFERS - 1 :] >= share)
    return float(run.metrics["step"].to_numpy()[BUFFERS - 1 + hits[0]]) if len(hits) else None


def _over_training(run: Record, column: str) -> float | None:
    """The mean over buffers, all of as many steps; in the first ones no episode may end."""
    if run.metrics is None or not run.finished or run.steps < run.planned_steps:
        return None
    return float(np.nanmean(run.metrics[column])) if has_curve(run) else None
