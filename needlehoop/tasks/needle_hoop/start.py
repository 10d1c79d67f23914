"""Where an episode begins: needle, hoop and tool, scattered over the layout's ranges."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.tasks.needle_hoop.layout import NeedleLayout
from needlehoop.tasks.psm import begun, tool_start
from needlehoop.tasks.start import Start, scatter, standing

DRAWS = 9
"""Uniform numbers that one reset consumes."""

_SUNK = 1.25e-6
"""How deep a needle at rest sinks into the table, m (measured). Laid exactly on the
surface, rounding decides which of its contacts exist, and the rest kick it."""


def start(layout: NeedleLayout, uniform: Tensor) -> Start:
    """Scatter needle, hoop and tool over the layout's ranges.

    Args:
        layout: nominal placement and ranges.
        uniform: numbers in [0, 1) ``(n, DRAWS)``, float64.
    """
    needle_xy = scatter(uniform[:, 0:2], layout.needle_position, layout.needle_position_range)
    yaw = scatter(uniform[:, 2:3], [layout.needle_yaw], [layout.needle_yaw_range])[:, 0]
    hoop = scatter(uniform[:, 3:6], layout.hoop_position, layout.hoop_position_range)
    needle = standing(needle_xy, layout.needle_thickness / 2 - _SUNK, yaw)
    return place(tool_start(layout, uniform[:, 6:9]), needle, hoop)


def place(robot: dict[str, Tensor], needle: Tensor, hoop: Tensor) -> Start:
    """A start from the robot's own, the needle's pose ``(n, 7)`` and the hoop's centre ``(n, 3)``.

    The lift position is above the needle, at the hoop's height.
    """
    stand = torch.cat((hoop[:, :2], torch.zeros_like(hoop[:, :1])), -1)
    lift = torch.cat((needle[:, :2], hoop[:, 2:]), -1)
    places = {"stand": stand, "hoop": hoop, "lift_position": lift}
    return begun(robot, places, {"needle": needle})
