"""Sizes and placement of the task."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class Layout:
    """Sizes, placement and randomisation ranges of the task; values in ``conf/task``.

    Lengths in m, angles in rad, positions in the world frame. Ranges are half-widths of
    uniform distributions about the nominal value.
    """

    needle_radius: float
    """Radius of the needle's arc, to its centre line."""
    needle_arc: float
    """Angle the arc spans."""
    needle_thickness: float
    """Diameter of the needle's cross-section."""
    needle_mass: float
    """kg."""
    needle_pickup: float
    """Where the pickup point lies: fraction of the arc, measured from the tip."""
    needle_position: tuple[float, float]
    """Nominal pickup point on the table, x and y."""
    needle_yaw: float
    """Nominal heading: rotation about z of the needle's frame."""
    needle_position_range: tuple[float, float]
    needle_yaw_range: float

    hoop_opening: float
    """Radius of the free opening."""
    hoop_tube: float
    """Radius of the ring's cross-section."""
    hoop_position: tuple[float, float, float]
    """Nominal centre of the opening; the hoop's axis is the world's y."""
    hoop_position_range: tuple[float, float, float]

    tool_position: tuple[float, float, float]
    """Nominal start of ``tool_midpoint``."""
    tool_position_range: tuple[float, float, float]
    tool_roll: float
    """Start of the rotation about the instrument's axis."""
    tool_jaw: float
    """Start of the jaw angle."""

    workspace_lower: tuple[float, float, float]
    workspace_upper: tuple[float, float, float]
    """Corners of the box that clamps ``tool_midpoint``'s target."""
    roll_range: float
    """The rotation's target stays within this of ``tool_roll``."""
    jaw_closed: float
    jaw_open: float
    """Limits of the jaw command."""

    rcm_height: float
    """Height of the remote centre of motion above the table."""
    grip: float
    """Distance of ``tool_midpoint`` from the wrist-yaw axis, along the blades."""

    timestep: float
    """Physics step, s."""

    def __post_init__(self) -> None:
        positive = [
            "needle_radius",
            "needle_arc",
            "needle_thickness",
            "needle_mass",
            "hoop_opening",
            "hoop_tube",
            "rcm_height",
            "grip",
            "timestep",
        ]
        for name in positive:
            if not getattr(self, name) > 0:
                raise ValueError(f"task.{name}: {getattr(self, name)} must be positive")
        for field in fields(self):
            if not np.all(np.isfinite(getattr(self, field.name))):
                raise ValueError(f"task.{field.name}: {getattr(self, field.name)} is not finite")
        if self.needle_arc >= 2 * np.pi:
            raise ValueError(f"task.needle_arc: {self.needle_arc} must be below a full turn")
        if not 0 < self.needle_pickup < 1:
            raise ValueError(f"task.needle_pickup: {self.needle_pickup} must lie in (0, 1)")
        for field in fields(self):
            if field.name.endswith("_range") and np.any(np.asarray(getattr(self, field.name)) < 0):
                raise ValueError(f"task.{field.name}: {getattr(self, field.name)} is negative")
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
