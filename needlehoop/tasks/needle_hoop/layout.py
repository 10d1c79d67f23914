"""Needle and hoop: sizes, where an episode begins, when a fact holds, and what success is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from needlehoop.config.strict import Range, Share, check_names
from needlehoop.tasks.layout import Angle, ArmEpisode, ArmLayout, Length, Place, Spread, Turn
from needlehoop.tasks.psm import begun, tool_start
from needlehoop.tasks.start import Chance, Start, standing


@dataclass(frozen=True)
class NeedleLayout(ArmLayout):
    """Sizes, placement and randomisation ranges; values in ``conf/task``.

    Lengths in m, angles in rad, positions in the world frame. Ranges are half-widths of
    uniform distributions about the nominal value.
    """

    needle_radius: Length
    """Radius of the needle's arc, to its centre line."""
    needle_arc: Angle
    """Angle the arc spans."""
    needle_thickness: Length
    """Diameter of the needle's cross-section."""
    needle_mass: Annotated[float, Range(0.0, 10.0, above=True)]
    """kg."""
    needle_pickup: Share
    """Where the pickup point lies: fraction of the arc, measured from the tip."""
    needle_position: tuple[Place, Place]
    """Nominal pickup point on the table, x and y."""
    needle_yaw: Turn
    """Nominal heading: rotation about z of the needle's frame."""
    needle_position_range: tuple[Spread, Spread]
    needle_yaw_range: Spread

    hoop_opening: Length
    """Radius of the free opening."""
    hoop_tube: Length
    """Radius of the ring's cross-section."""
    hoop_position: tuple[Place, Place, Place]
    """Nominal centre of the opening; the hoop's axis is the world's y."""
    hoop_position_range: tuple[Spread, Spread, Spread]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.needle_arc >= 2 * np.pi:
            raise ValueError(f"task.needle_arc: {self.needle_arc} must be below a full turn")
        if not 0 < self.needle_pickup < 1:
            raise ValueError(f"task.needle_pickup: {self.needle_pickup} must lie in (0, 1)")

    @property
    def needle_angles(self) -> tuple[float, float]:
        """Arc angles of tail and tip; zero is the pickup point."""
        tip = self.needle_arc * self.needle_pickup
        return tip - self.needle_arc, tip

    def centre_line(self, angles: np.ndarray) -> np.ndarray:
        """Points ``(n, 3)`` of the needle's centre line, in the needle's frame.

        The frame sits at the pickup point: x towards the arc's centre, y along the
        needle towards the tip, z out of the arc's plane.
        """
        return self.needle_radius * np.stack(
            (1.0 - np.cos(angles), np.sin(angles), np.zeros_like(angles)), -1
        )


SUCCESSES = ("thread", "touch")


@dataclass(frozen=True)
class NeedleRules(ArmEpisode):
    """When a fact of needle and hoop holds, and what success is; values in ``conf/episode``."""

    lift_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``lifted``: the pickup point came this near the lift position, m."""
    goal_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``touched``: the tip is this near the goal, m."""
    thread_depth: Annotated[float, Range(-1.0, 1.0)]
    """``threaded``: the tip is at least this far beyond the hoop's plane, m."""
    success: str = SUCCESSES[0]
    """``thread``: the needle is through the hoop. ``touch``: its tip is at the goal, as in the
    paper."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names("episode.success", [self.success], SUCCESSES)


_SUNK = 1.25e-6
"""How deep a needle at rest sinks into the table, m (measured). Laid exactly on the
surface, rounding decides which of its contacts exist, and the rest kick it."""


def start(layout: NeedleLayout, chance: Chance) -> Start:
    """Scatter needle, hoop and tool over the layout's ranges."""
    needle_xy = chance.place(layout.needle_position, layout.needle_position_range)
    yaw = chance.about(layout.needle_yaw, layout.needle_yaw_range)
    hoop = chance.place(layout.hoop_position, layout.hoop_position_range)
    needle = standing(needle_xy, layout.needle_thickness / 2 - _SUNK, yaw)
    return place(tool_start(layout, chance), needle, hoop)


def place(robot: dict[str, Tensor], needle: Tensor, hoop: Tensor) -> Start:
    """A start from the robot's own, the needle's pose ``(n, 7)`` and the hoop's centre ``(n, 3)``.

    The lift position is above the needle, at the hoop's height.
    """
    stand = torch.cat((hoop[:, :2], torch.zeros_like(hoop[:, :1])), -1)
    lift = torch.cat((needle[:, :2], hoop[:, 2:]), -1)
    places = {"stand": stand, "hoop": hoop, "lift_position": lift}
    return begun(robot, places, {"needle": needle})
