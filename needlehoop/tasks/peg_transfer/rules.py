"""When a fact of the peg transfer holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from needlehoop.config.strict import Range
from needlehoop.tasks.episode import ArmEpisode

_Above = Annotated[float, Range(0.0, 10.0, above=True)]


@dataclass(frozen=True)
class PegRules(ArmEpisode):
    """Thresholds in m, rad, m/s and rad/s; values in ``conf/episode``."""

    arrive_radius: _Above
    """``arrived``: the hole's centre is this near the marked peg's axis."""
    rest_gap: _Above
    """``placed``: the block's centre is this near the height at which it stands on the board."""
    rest_tilt: _Above
    """``placed``: the block's axis is this near the vertical."""
    rest_speed: _Above
    rest_spin: _Above
    """``placed``: the block moves and turns slower than this."""
