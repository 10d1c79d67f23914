"""The names of a run's folder and files, for those who write them and those who only read them."""

from __future__ import annotations

from collections.abc import Iterable

CONFIG, MANIFEST, REWARD = "config.yaml", "manifest.json", "reward.txt"
METRICS, EVALUATIONS = "metrics.csv", "evaluations.csv"
CHECKPOINT, EVALUATION, VIDEO = "checkpoint.pt", "evaluation.json", "video.mp4"

SWEEPS, OUTCOME = ".sweeps", "outcome.json"
"""Beside the studies: a folder for each sweep, in it one for each of its jobs, with its note."""

SIGNALS = "signals"
"""Stands among the cameras where the agent is told the state."""


def seen(cams: Iterable[str], signals: bool) -> str:
    """What a run's folder calls that which its agent sees: ``dep_front+seg_side``."""
    return "+".join((*cams, *([SIGNALS] if signals else [])))
