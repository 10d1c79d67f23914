"""Sizes and placement of block and pegs, and when a fact holds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from needlehoop.config.strict import Range
from needlehoop.tasks.episode import ArmEpisode
from needlehoop.tasks.layout import ArmLayout, Length, Place, Spread, Turn

WALLS = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
"""Directions of the walls' outward normals about the block's z, rad; the first is grasped."""

PEGS = 6


def at_wall(angle: float, out: float, along: float) -> tuple[float, float]:
    """Place x, y ``out`` from the hole's axis along a wall's normal, and ``along`` the wall."""
    cos, sin = math.cos(angle), math.sin(angle)
    return out * cos - along * sin, out * sin + along * cos


Index = Annotated[int, Range(0, PEGS - 1)]


@dataclass(frozen=True)
class PegLayout(ArmLayout):
    """Sizes, placement and randomisation ranges; values in ``conf/task``.

    Lengths in m, angles in rad, positions in the world frame. Ranges are half-widths of
    uniform distributions about the nominal value. The block is a triangular tube of three
    walls; its frame sits in the middle of the hole, at half its height.
    """

    hole_radius: Length
    """Radius of the largest cylinder that fits through the triangular hole."""
    wall: Length
    """Thickness of a wall."""
    block_height: Length
    block_mass: Annotated[float, Range(0.0, 10.0, above=True)]
    """kg."""
    pickup_depth: Length
    """How far below the first wall's upper edge the pickup point lies."""

    peg_radius: Length
    peg_height: Length
    """Of the pegs that are not marked."""
    marked_radius: Length
    marked_height: Length
    """Of the marked peg: larger, so that depth alone shows which it is."""
    mark_radius: Length
    """Of the disc that is painted on the board about the marked peg."""

    pegs: tuple[tuple[Place, Place], ...]
    """Where pegs stand on the board, x and y."""
    starts: tuple[Index, ...]
    """Of ``pegs``, by index: the block begins over one of them."""
    goals: tuple[Index, ...]
    """Of ``pegs``: one of them, not the block's, is the marked one."""

    board_range: tuple[Spread, Spread]
    """All pegs are moved together by as much."""
    block_yaw: Turn
    """Nominal heading: direction of the first wall's normal."""
    block_yaw_range: Spread
    block_position_range: tuple[Spread, Spread]
    """The hole's centre, about its peg."""
    carry_height: Length
    """Gap between a carried block and the marked peg's top."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.pegs) != PEGS:
            raise ValueError(f"task.pegs: {len(self.pegs)} places; expected {PEGS}")
        for name, chosen in (("starts", self.starts), ("goals", self.goals)):
            if not chosen or len(set(chosen)) < len(chosen):
                raise ValueError(f"task.{name}: {chosen} must name pegs, each once")
        if len(self.goals) == 1 and self.goals[0] in self.starts:
            raise ValueError(f"task.goals: {self.goals} may be the peg that the block begins over")
        if self.marked_radius >= self.hole_radius:
            raise ValueError(f"task.marked_radius: must be below hole_radius={self.hole_radius}")

    @property
    def wall_length(self) -> float:
        """Of a wall: its inner edge ends on the next wall's outer face."""
        return 2 * (math.sqrt(3) * self.hole_radius + 2 / math.sqrt(3) * self.wall)

    @property
    def corners(self) -> np.ndarray:
        """The walls' outer corners seen along the block's z, ``(6, 2)``, block frame."""
        out, half = self.hole_radius + self.wall, self.wall_length / 2
        return np.array([at_wall(a, out, s * half) for a in WALLS for s in (-1, 1)])

    @property
    def pickup(self) -> tuple[float, float, float]:
        """The pickup point in the block's frame."""
        return self.hole_radius + self.wall / 2, 0.0, self.block_height / 2 - self.pickup_depth

    @property
    def carried(self) -> float:
        """Height of the block's centre when it is carried upright."""
        return self.marked_height + self.carry_height + self.block_height / 2


_Above = Annotated[float, Range(0.0, 10.0, above=True)]


@dataclass(frozen=True)
class PegRules(ArmEpisode):
    """When a fact of the peg transfer holds, m, rad, m/s and rad/s; values in ``conf/episode``."""

    arrive_radius: _Above
    """``arrived``: the hole's centre is this near the marked peg's axis."""
    rest_gap: _Above
    """``placed``: the block's centre is this near the height at which it stands on the board."""
    rest_tilt: _Above
    """``placed``: the block's axis is this near the vertical."""
    rest_speed: _Above
    rest_spin: _Above
    """``placed``: the block moves and turns slower than this."""
