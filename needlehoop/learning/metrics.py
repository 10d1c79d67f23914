"""The columns of a run's ``metrics.csv``."""

from __future__ import annotations

import resource
import sys
from typing import Any

from tensordict import TensorDictBase

EPISODE_FACTS = {
    "success": "success",
    "threaded": "threaded",
    "touched": "has_touched",
    "cheat": "cheat",
    "grasped": "has_grasped",
    "lifted": "lifted",
}
"""Rates over episodes, by the fact that is true at an episode's last step."""


def episode_columns(buffer: TensorDictBase) -> dict[str, float]:
    """Means over the episodes that ended in a buffer ``(num_envs, horizon)``; NaN for none.

    The return is the final potential; ``length`` is in steps.
    """
    following: Any = buffer["next"]
    last = following[following["done"].squeeze(-1)]
    columns = {
        "episodes": float(len(last)),
        "return": float(last["potential"].mean()),
        **{f"term_{name}": float(term.mean()) for name, term in last["terms"].items()},
    }
    for column, fact in EPISODE_FACTS.items():
        columns[column] = float(last["facts", fact].float().mean())
    columns["length"] = float(last["steps"].float().mean())
    return columns


def peak_memory() -> float:
    """The most memory this process has had, GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)
