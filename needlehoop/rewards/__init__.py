"""Rewards: functions from signals to named terms. They prefer; they never decide success.

The terms are summed to a potential, and each step pays the potential's difference. So an
episode's return is its last potential.
"""

from needlehoop.rewards.called import given
from needlehoop.rewards.loader import (
    NONE,
    REWARDS,
    allow,
    check,
    load,
    pin,
    recall,
    reference_reward,
    text,
)
from needlehoop.rewards.terms import Reward, potential
from needlehoop.rewards.written import RewardError

__all__ = [
    "NONE",
    "REWARDS",
    "Reward",
    "RewardError",
    "allow",
    "check",
    "given",
    "load",
    "pin",
    "potential",
    "recall",
    "reference_reward",
    "text",
]
