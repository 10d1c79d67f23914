"""Block and pegs: sizes, where an episode begins, and when a fact holds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from torch import Tensor

from needlehoop.config.strict import Range
from needlehoop.tasks.layout import ArmEpisode, ArmLayout, Length, Place, Spread, Turn
from needlehoop.tasks.psm import begun, tool_start
from needlehoop.tasks.start import Chance, Start, standing

WALLS = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
"""Directions of the walls' outward normals about the block's z, rad; the first is grasped."""

PEGS = 6

OTHER_PEGS = tuple(f"peg_{index}" for index in range(PEGS - 1))
"""Bodies of the pegs that are not marked."""


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


_SUNK = 2.82e-7
"""How deep a block at rest sinks into the table, m (measured)."""


def start(layout: PegLayout, chance: Chance) -> Start:
    """Draw the block's peg and the marked one; scatter board, block and tool."""
    begins, marked = _choose(layout, chance.number(), chance.number())
    shift = chance.place((0.0, 0.0), layout.board_range)
    yaw = chance.about(layout.block_yaw, layout.block_yaw_range)
    off = chance.place((0.0, 0.0), layout.block_position_range)
    places = torch.tensor(layout.pegs, dtype=torch.float64)
    block = standing(places[begins] + shift + off, layout.block_height / 2 - _SUNK, yaw)
    return place(layout, tool_start(layout, chance), block, shift, marked)


def place(
    layout: PegLayout, robot: dict[str, Tensor], block: Tensor, shift: Tensor, marked: Tensor
) -> Start:
    """A start from the robot's own, the block's pose, the board's shift and the marked peg.

    Args:
        layout: where pegs stand on the board.
        robot: of a ``Start``.
        block: pose ``(n, 7)``.
        shift: of the board ``(n, 2)``, m.
        marked: index of the marked peg ``(n,)``.
    """
    names = OTHER_PEGS
    flat = torch.zeros_like(shift[:, :1])
    places = torch.tensor(layout.pegs, dtype=torch.float64)
    # The other pegs take the places that are left, in their order.
    others = torch.arange(len(names)) + (torch.arange(len(names)) >= marked.unsqueeze(-1))

    def standing(index: Tensor) -> Tensor:
        return torch.cat((places[index] + shift, flat), -1)

    mocap = {name: standing(others[:, i]) for i, name in enumerate(names)}
    lift = torch.cat((block[:, :2], torch.full_like(flat, layout.carried)), -1)
    board = torch.cat((shift, flat), -1)
    mocap |= {"board": board, "marked": standing(marked), "lift_position": lift}
    return begun(robot, mocap, {"block": block})


def _choose(layout: PegLayout, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Indices ``(n,)`` of the block's peg and of the marked one, which are never the same."""
    starts, goals = torch.tensor(layout.starts), torch.tensor(layout.goals)
    begins = starts[(first * len(starts)).long()]
    taken = (goals == begins.unsqueeze(-1)).long()
    free = len(goals) - taken.sum(-1)
    pick = (second * free).long()
    # Those at and behind the taken one are counted one further.
    at = torch.where(taken.any(-1), taken.argmax(-1), torch.full_like(pick, len(goals)))
    return begins, goals[pick + (pick >= at)]
