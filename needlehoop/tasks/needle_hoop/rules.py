"""When a fact of needle and hoop holds, and what success is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from needlehoop.config.strict import Range
from needlehoop.tasks.episode import ArmEpisode, check_option

SUCCESSES = ("thread", "touch")


@dataclass(frozen=True)
class NeedleRules(ArmEpisode):
    """Thresholds in m; values in ``conf/episode``."""

    lift_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``lifted``: the pickup point came this near the lift position."""
    goal_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``touched``: the tip is this near the goal."""
    thread_depth: Annotated[float, Range(-1.0, 1.0)]
    """``threaded``: the tip is at least this far beyond the hoop's plane."""
    success: str = SUCCESSES[0]
    """``thread``: the needle is through the hoop. ``touch``: its tip is at the goal, as in the
    paper."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_option("success", self.success, SUCCESSES)
