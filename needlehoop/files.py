"""The names of a run's files, for those who write and those who only read them; whole writes."""

from __future__ import annotations

import os
from pathlib import Path

CONFIG, MANIFEST, REWARD = "config.yaml", "manifest.json", "reward.txt"
METRICS, EVALUATIONS = "metrics.csv", "evaluations.csv"
CHECKPOINT, EVALUATION, VIDEO = "checkpoint.pt", "evaluation.json", "video.mp4"


def write_whole(path: Path, content: str | bytes) -> None:
    """Replace a file in one step, once all of it is on the disk."""
    partial = path.with_name(path.name + ".partial")
    data = content.encode() if isinstance(content, str) else content
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
