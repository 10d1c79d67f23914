"""Sizes and placement of the task."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from needlehoop.config.strict import Range, Share

Length = Annotated[float, Range(1e-5, 1.0)]
"""m; the arm reaches a quarter of the most, and of far less MuJoCo makes no shapes."""

Place = Annotated[float, Range(-1.0, 1.0)]
"""A coordinate, m."""

Spread = Annotated[float, Range(0.0, 2 * math.pi)]
"""A half-width, m or rad."""

Angle = Annotated[float, Range(1e-2, 2 * math.pi)]
Turn = Annotated[float, Range(-2 * math.pi, 2 * math.pi)]
"""rad."""


@dataclass(frozen=True)
class Layout:
    """Sizes, placement and randomisation ranges of the task; values in ``conf/task``.

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

    tool_position: tuple[Place, Place, Place]
    """Nominal start of ``tool_midpoint``."""
    tool_position_range: tuple[Spread, Spread, Spread]
    tool_roll: Turn
    """Start of the rotation about the instrument's axis."""
    tool_jaw: Turn
    """Start of the jaw angle."""

    workspace_lower: tuple[Place, Place, Place]
    workspace_upper: tuple[Place, Place, Place]
    """Corners of the box that clamps ``tool_midpoint``'s target."""
    roll_range: Spread
    """The rotation's target stays within this of ``tool_roll``."""
    jaw_closed: Turn
    jaw_open: Turn
    """Limits of the jaw command."""

    rcm_height: Length
    """Height of the remote centre of motion above the table."""
    grip: Length
    """Distance of ``tool_midpoint`` from the wrist-yaw axis, along the blades."""

    timestep: Annotated[float, Range(1e-4, 0.01)]
    """Physics step, s."""

    def __post_init__(self) -> None:
        if self.needle_arc >= 2 * np.pi:
            raise ValueError(f"task.needle_arc: {self.needle_arc} must be below a full turn")
        if not 0 < self.needle_pickup < 1:
            raise ValueError(f"task.needle_pickup: {self.needle_pickup} must lie in (0, 1)")
        lower, upper = self.workspace_lower, self.workspace_upper
        if not all(a < b for a, b in zip(lower, upper, strict=True)):
            raise ValueError(f"task.workspace_lower: {lower} must be below {upper}")
        if not self.jaw_closed < self.jaw_open:
            raise ValueError(f"task.jaw_closed: {self.jaw_closed} must be below {self.jaw_open}")

    @property
    def needle_angles(self) -> tuple[float, float]:
        """Arc angles of tail and tip; zero is the pickup point."""
        tip = self.needle_arc * self.needle_pickup
        return tip - self.needle_arc, tip

    @property
    def rcm(self) -> np.ndarray:
        """Position of the remote centre of motion, ``(3,)``."""
        return np.array([0.0, 0.0, self.rcm_height])

    def centre_line(self, angles: np.ndarray) -> np.ndarray:
        """Points ``(n, 3)`` of the needle's centre line, in the needle's frame.

        The frame sits at the pickup point: x towards the arc's centre, y along the
        needle towards the tip, z out of the arc's plane.
        """
        return self.needle_radius * np.stack(
            (1.0 - np.cos(angles), np.sin(angles), np.zeros_like(angles)), -1
        )
