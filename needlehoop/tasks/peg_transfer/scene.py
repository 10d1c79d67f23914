"""Block, pegs and board: sizes, bodies, what is sensed, where an episode begins, the rules."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.config.strict import Range
from needlehoop.scene.shapes import collision
from needlehoop.scene.signals import of_body, of_site
from needlehoop.scene.spec import Materials
from needlehoop.tasks.layout import ArmEpisode, ArmLayout, Length, Place, Spread, Turn
from needlehoop.tasks.psm import add_grasp, servos, tool_start
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


_Index = Annotated[int, Range(0, PEGS - 1)]
_Above = Annotated[float, Range(0.0, 10.0, above=True)]


@dataclass(frozen=True)
class PegLayout(ArmLayout):
    """Block, pegs and where they are; see ``Layout``.

    The block is a triangular tube of three walls; its frame sits in the middle of the hole, at
    half its height.
    """

    hole_radius: Length
    """Radius of the largest cylinder that fits through the triangular hole."""
    wall: Length
    """Thickness of a wall."""
    block_height: Length
    block_mass: _Above
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
    starts: tuple[_Index, ...]
    """Of ``pegs``, by index: the block begins over one of them."""
    goals: tuple[_Index, ...]
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
        if not self.starts or not all(set(self.goals) - {start} for start in self.starts):
            raise ValueError(f"task.goals: {self.goals} must leave a peg for each of {self.starts}")

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
    def carried(self) -> float:
        """Height of the block's centre when it is carried upright."""
        return self.marked_height + self.carry_height + self.block_height / 2


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


MATERIALS: Materials = {
    "block": ((0.93, 0.30, 0.16), 0.3, 0.4),
    "peg": ((0.86, 0.86, 0.88), 0.3, 0.4),
    "marked": ((0.20, 0.85, 0.25), 0.3, 0.4),
    "board": ((0.20, 0.21, 0.27), 0.05, 0.1),
}

THINGS = {
    "pickup_point": of_site(
        "position", "pickup_point", "where the block should be grasped: in one of its walls"
    ),
    "block_position": of_body("position", "block", "middle of the block and of its hole"),
    "block_quat": of_body(
        "orientation",
        "block",
        "block frame: z along the hole, x from the hole through the wall that is to be grasped",
    ),
    "block_velocity": of_body("velocity", "block", "of the block's middle"),
    "block_spin": of_body("spin", "block", "angular velocity of the block"),
    "goal": of_site("position", "goal", "middle of a block that stands over the marked peg"),
    "above_goal": of_site(
        "position", "above_goal", "middle of a block that is carried above the marked peg"
    ),
    "lift_position": of_body(
        "position", "lift_position", "above the block's start, at the height of above_goal"
    ),
}

_PAINT = 5e-5
"""Thickness of paint, m: enough to be drawn before what is below."""

_HARD = {"solref": [0.004, 1.0], "solimp": [0.98, 0.998, 0.0005, 0.5, 2.0]}
"""Contacts of the block. They give less than the weld, so a held block is not drawn through a peg,
and less than the arm's own contacts, which sink 4 mm into so light a thing (measured)."""

_SEEN_AND_FELT = {**_HARD, **collision(True), "group": collision(False)["group"]}


def build(spec: mujoco.MjSpec, layout: PegLayout, rules: PegRules) -> None:
    """Add board, pegs and block, and what ``episode.grasp`` holds the block with."""
    # A block that lands on an edge: fewer, and the solver stops half-way and kicks it (measured).
    spec.option.ls_iterations = 50
    _add_board(spec, layout)
    _add_block(spec, layout)
    add_grasp(spec, rules, "block", solref=[0.008, 1.0], solimp=[0.95, 0.99, 0.001, 0.5, 2.0])


def _add_block(spec: mujoco.MjSpec, layout: PegLayout) -> None:
    """A free body of three walls, which are seen as they are felt."""
    height = layout.block_height / 2
    body = spec.worldbody.add_body(name="block", pos=[0, 0, height])
    body.add_freejoint(name="block")
    out = layout.hole_radius + layout.wall / 2
    for index, angle in enumerate(WALLS):
        body.add_geom(
            name=f"wall_{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[out * math.cos(angle), out * math.sin(angle), 0],
            quat=[math.cos(angle / 2), 0, 0, math.sin(angle / 2)],
            size=[layout.wall / 2, layout.wall_length / 2, height],
            mass=layout.block_mass / len(WALLS),
            material="block",
            friction=[0.5, 0.002, 0.0001],
            solmix=100.0,
            **_SEEN_AND_FELT,
        )
        for side in (1, 2):
            # The contact of a jaw's pad with a wall: the pad's friction, the block's hardness.
            pad = f"jaw_{side}_pad"
            slide, spin, roll = spec.geom(pad).friction
            spec.add_pair(
                name=f"{pad}_wall_{index}",
                geomname1=pad,
                geomname2=f"wall_{index}",
                condim=6,
                friction=[slide, slide, spin, roll, roll],
                **_HARD,
            )
    pickup = [out, 0, height - layout.pickup_depth]
    body.add_site(name="pickup_point", pos=pickup, size=[0.001] * 3)


def _add_board(spec: mujoco.MjSpec, layout: PegLayout) -> None:
    """The board and its pegs: mocap bodies, placed at reset."""
    board = spec.worldbody.add_body(name="board", mocap=True)
    middle = [sum(axis) / len(axis) for axis in zip(*layout.pegs, strict=True)]
    board.add_geom(
        name="board",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[*middle, -0.001],
        # It is drawn, and the table below is felt.
        size=[0.040, 0.050, 0.001 + _PAINT],
        material="board",
        **collision(False),
    )
    for name in OTHER_PEGS:
        peg = spec.worldbody.add_body(name=name, mocap=True)
        _add_peg(peg, "peg", layout.peg_radius, layout.peg_height)
    marked = spec.worldbody.add_body(name="marked", mocap=True)
    _add_peg(marked, "marked", layout.marked_radius, layout.marked_height)
    marked.add_geom(
        name="mark",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        fromto=[0, 0, 0, 0, 0, 3 * _PAINT],
        size=[layout.mark_radius, 0, 0],
        material="marked",
        **collision(False),
    )
    marked.add_site(name="goal", pos=[0, 0, layout.block_height / 2], size=[0.001] * 3)
    marked.add_site(name="above_goal", pos=[0, 0, layout.carried], size=[0.001] * 3)
    spec.worldbody.add_body(name="lift_position", mocap=True)


def _add_peg(body: mujoco.MjsBody, material: str, radius: float, height: float) -> None:
    """A rod with a round top that is as high as said."""
    body.add_geom(
        name=f"{body.name}_rod",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0, 0, 0, 0, 0, height - radius],
        size=[radius, 0, 0],
        material=material,
        friction=[0.3, 0.002, 0.0001],
        **_SEEN_AND_FELT,
    )


def start(layout: PegLayout, chance: Chance) -> Start:
    """Draw the block's peg and the marked one; scatter board, block and tool."""
    starts, goals = torch.tensor(layout.starts), torch.tensor(layout.goals)
    begins = starts[(chance.number() * len(starts)).long()]
    # Indices among the goals that are left: from the block's peg on they are one further.
    taken = (goals == begins.unsqueeze(-1)).long()
    pick = (chance.number() * (len(goals) - taken.sum(-1))).long()
    marked = goals[pick + taken.cumsum(-1)[torch.arange(len(pick)), pick]]
    shift = chance.place((0.0, 0.0), layout.board_range)
    yaw = chance.about(layout.block_yaw, layout.block_yaw_range)
    off = chance.place((0.0, 0.0), layout.block_position_range)
    places = torch.tensor(layout.pegs, dtype=torch.float64)
    # A block at rest sinks so deep into the table (measured).
    height = layout.block_height / 2 - 2.82e-7
    block = standing(places[begins] + shift + off, height, yaw)
    return place(layout, tool_start(layout, chance), block, shift, marked)


def place(
    layout: PegLayout, robot: dict[str, Tensor], block: Tensor, shift: Tensor, marked: Tensor
) -> Start:
    """A start from the robot's own, the block's pose ``(n, 7)``, the board's shift ``(n, 2)``, m,
    and the index of the marked peg ``(n,)``.
    """
    flat = torch.zeros_like(shift[:, :1])
    places = torch.tensor(layout.pegs, dtype=torch.float64)
    # The other pegs take the places that are left, in their order.
    left = torch.arange(PEGS - 1)
    indices = left + (left >= marked.unsqueeze(-1))
    pegs = {"marked": marked, **dict(zip(OTHER_PEGS, indices.unbind(-1), strict=True))}
    mocap = {name: torch.cat((places[at] + shift, flat), -1) for name, at in pegs.items()}
    mocap["board"] = torch.cat((shift, flat), -1)
    mocap["lift_position"] = torch.cat((block[:, :2], flat + layout.carried), -1)
    return Start(robot, free={"block": block}, mocap=mocap, control=servos(robot))
