"""The columns of ``metrics.csv``."""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping
from typing import Any

from tensordict import TensorDictBase


def episode_columns(buffer: TensorDictBase, facts: Mapping[str, str]) -> dict[str, float]:
    """Means over the episodes that ended in a buffer ``(num_envs, horizon)``; NaN for none.

    The return is the final potential; ``length`` is in steps.

    Args:
        buffer: as a method of learning gives it.
        facts: to be reported, by column; ``Task.columns``.
    """
    following: Any = buffer["next"]
    last = following[following["done"].squeeze(-1)]
    columns = {
        "episodes": float(len(last)),
        "return": float(last["potential"].mean()),
        **{f"term_{name}": float(term.mean()) for name, term in last["terms"].items()},
    }
    for column, fact in facts.items():
        columns[column] = float(last["facts", fact].float().mean())
    columns["length"] = float(last["steps"].float().mean())
    return columns


def peak_memory() -> float:
    """The most memory this process has had, GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)
