"""Rewards: functions from signals to named terms. They prefer; they never decide success.

The terms are summed to a potential, and each step pays the potential's difference, so
an episode's return is its last potential.
"""

from needlehoop.rewards.loader import NONE, REWARDS, load, text
from needlehoop.rewards.terms import Reward, potential
from needlehoop.rewards.written import RewardError, pin
from needlehoop.rewards.yardstick import yardstick

__all__ = [
    "NONE",
    "REWARDS",
    "Reward",
    "RewardError",
    "load",
    "pin",
    "potential",
    "text",
    "yardstick",
]
