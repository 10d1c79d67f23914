"""The names of a run's files, for those who write them and for those who only read them."""

from __future__ import annotations

CONFIG, MANIFEST, REWARD = "config.yaml", "manifest.json", "reward.txt"
METRICS, EVALUATIONS = "metrics.csv", "evaluations.csv"
CHECKPOINT, EVALUATION, VIDEO = "checkpoint.pt", "evaluation.json", "video.mp4"
