"""Where an episode begins: bumps of random height, a target on one of them, and the tool."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.tasks.psm import servos, start_of
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
    tool = scatter(uniform[:, -3:], layout.tool_position, layout.tool_position_range)
    return place(layout, tool, torch.stack(tops, 1), chosen)


def place(layout: ReachLayout, tool: Tensor, tops: Tensor, chosen: Tensor) -> Start:
    """A start from places.

    Args:
        layout: sizes.
        tool: ``tool_midpoint`` ``(n, 3)``, m.
        tops: of the bumps ``(n, BUMPS, 3)``, m.
        chosen: index of the target's bump ``(n,)``.
    """
    n = len(tool)
    up = torch.tensor((0.0, 0.0, layout.target_above_bump), dtype=tops.dtype)
    places = {"target": tops[torch.arange(n), chosen] + up}
    for index in range(BUMPS):
        places[f"bump_{index}"] = places[f"mark_{index}"] = tops[:, index]
    roll, jaw = (tool.new_full((n,), x) for x in (layout.tool_roll, layout.tool_jaw))
    robot = start_of(layout, tool, roll, jaw)
    return Start(
        robot=robot,
        free={},
        mocap=places,
        control=servos(robot),
    )
