"""Where an episode begins: bumps of random height, a target on one of them, and the tool."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.tasks.psm import begun, tool_start
from needlehoop.tasks.reach.layout import BUMPS, ReachLayout
from needlehoop.tasks.start import Start, scatter

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
