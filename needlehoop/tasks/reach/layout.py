"""The phantom and its marks: sizes, where an episode begins, and when a fact holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from needlehoop.config.strict import Count, Range
from needlehoop.tasks.episode import ToolEpisode
from needlehoop.tasks.layout import ArmLayout, Length, Place, Spread
from needlehoop.tasks.psm import begun, tool_start
from needlehoop.tasks.start import Start, scatter

BUMPS = 5
"""Bumps of the phantom; each has a mark on top, and one of them the target."""


@dataclass(frozen=True)
class ReachLayout(ArmLayout):
    """Sizes, placement and randomisation ranges; values in ``conf/task``.

    Lengths in m, positions in the world frame. Ranges are half-widths of uniform
    distributions about the nominal value.
    """

    bump_positions: tuple[tuple[Place, Place], ...]
    """Nominal x and y of each bump."""
    bump_radii: tuple[Length, ...]
    """Radius of each bump: a round column with the half of a sphere on top."""
    bump_position_range: tuple[Spread, Spread]
    bump_height: Length
    """Nominal height of a bump above the table. Each has a height of its own."""
    bump_height_range: Spread

    mark_radius: Length
    """Radius of the flat discs on top of the bumps."""
    target_radius: Length
    """Radius of the button that marks the target."""
    target_height: Length
    """Height of the button's upper face above the top of its bump."""
    clearance: Length
    """Height of the target point above the button: the jaws end before ``tool_midpoint``."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("bump_positions", "bump_radii"):
            count = len(getattr(self, key))
            if count != BUMPS:
                raise ValueError(f"task.{key}: {count} values; there are {BUMPS} bumps")
        if not self.bump_height_range < self.bump_height:
            raise ValueError(
                f"task.bump_height_range: {self.bump_height_range} must be below"
                f" bump_height={self.bump_height}"
            )

    @property
    def target_above_bump(self) -> float:
        """Height of the target point above the top of its bump."""
        return self.target_height + self.clearance


@dataclass(frozen=True)
class ReachRules(ToolEpisode):
    """When a fact of reach holds; values in ``conf/episode``."""

    near_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``near``: ``tool_midpoint`` is this near the target, m."""
    near_steps: Count
    """``stayed``: it has been near after so many steps, one after the other."""


DRAWS = 3 * BUMPS + 1 + 3
"""Uniform numbers that one reset consumes: for the bumps, the choice of one, the tool."""


def start(layout: ReachLayout, uniform: Tensor) -> Start:
    """Scatter bumps and tool over the layout's ranges, and choose the target's bump.

    Args:
        layout: nominal placement and ranges.
        uniform: numbers in [0, 1) ``(n, DRAWS)``, float64.
    """
    half = (*layout.bump_position_range, layout.bump_height_range)
    tops = [
        scatter(uniform[:, 3 * i : 3 * i + 3], (x, y, layout.bump_height), half)
        for i, (x, y) in enumerate(layout.bump_positions)
    ]
    chosen = (BUMPS * uniform[:, 3 * BUMPS]).long()
    robot = tool_start(layout, uniform[:, -3:])
    return place(layout, robot, torch.stack(tops, 1), chosen)


def place(layout: ReachLayout, robot: dict[str, Tensor], tops: Tensor, chosen: Tensor) -> Start:
    """A start from places.

    Args:
        layout: sizes.
        robot: of a ``Start``.
        tops: of the bumps ``(n, BUMPS, 3)``, m.
        chosen: index of the target's bump ``(n,)``.
    """
    up = torch.tensor((0.0, 0.0, layout.target_above_bump), dtype=tops.dtype)
    places = {"target": tops[torch.arange(len(tops)), chosen] + up}
    for index in range(BUMPS):
        places[f"bump_{index}"] = places[f"mark_{index}"] = tops[:, index]
    return begun(robot, places)
