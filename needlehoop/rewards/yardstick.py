"""The reward that all policies are measured by, whatever they were trained on."""

from __future__ import annotations

from needlehoop.rewards.human import Human
from needlehoop.rewards.loader import load
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF


def yardstick() -> Human:
    """The human reward with its default values, ``conf/reward/human.yaml``."""
    reward = load(read_yaml(CONF / "reward/human.yaml"))
    assert isinstance(reward, Human)
    return reward
