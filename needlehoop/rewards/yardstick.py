"""The reward that all policies are measured by, whatever they were trained on."""

from __future__ import annotations

from needlehoop.rewards.loader import load
from needlehoop.rewards.terms import Reward
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF


def yardstick() -> Reward:
    """The human reward with its default values, ``conf/reward/human.yaml``."""
    return load(read_yaml(CONF / "reward/human.yaml"))
