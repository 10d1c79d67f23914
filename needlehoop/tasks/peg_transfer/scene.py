"""Block, pegs and board as MuJoCo bodies, and what is sensed of them."""

from __future__ import annotations

import math

import mujoco

from needlehoop.scene.shapes import collision
from needlehoop.scene.signals import of_body, of_site
from needlehoop.scene.spec import Materials
from needlehoop.tasks.grasping import add_weld
from needlehoop.tasks.peg_transfer.layout import OTHER_PEGS, WALLS, PegLayout, PegRules

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

_BOARD = (0.040, 0.050)
"""Half the board's size, x and y, m: it is drawn, and the table below is felt."""

_HARD = {"solref": [0.004, 1.0], "solimp": [0.98, 0.998, 0.0005, 0.5, 2.0]}
"""Contacts of the block. They give less than the weld, so a held block is not drawn through a peg,
and less than the arm's own contacts, which sink 4 mm into so light a thing (measured)."""


def build(spec: mujoco.MjSpec, layout: PegLayout, rules: PegRules) -> None:
    """Add board, pegs and block, and the (inactive) weld for ``episode.grasp=weld``."""
    # A block that lands on an edge: fewer, and the solver stops half-way and kicks it (measured).
    spec.option.ls_iterations = 50
    _add_board(spec, layout)
    _add_block(spec, layout)
    add_weld(spec, rules, "block", solref=[0.008, 1.0], solimp=[0.95, 0.99, 0.001, 0.5, 2.0])


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
            **_HARD,
            **_seen_and_felt(),
        )
        for side in (1, 2):
            _add_pair(spec, f"jaw_{side}_pad", f"wall_{index}")
    body.add_site(name="pickup_point", pos=layout.pickup, size=[0.001] * 3)


def _add_pair(spec: mujoco.MjSpec, pad: str, wall: str) -> None:
    """The contact of a jaw's pad with a wall: the pad's friction, the block's hardness."""
    sliding = spec.geom(pad).friction
    spec.add_pair(
        name=f"{pad}_{wall}",
        geomname1=pad,
        geomname2=wall,
        condim=6,
        friction=[sliding[0], sliding[0], sliding[1], sliding[2], sliding[2]],
        **_HARD,
    )


def _add_board(spec: mujoco.MjSpec, layout: PegLayout) -> None:
    """The board and its pegs: mocap bodies, placed at reset."""
    board = spec.worldbody.add_body(name="board", mocap=True)
    middle = [sum(axis) / len(axis) for axis in zip(*layout.pegs, strict=True)]
    board.add_geom(
        name="board",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[*middle, -0.001],
        size=[*_BOARD, 0.001 + _PAINT],
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
        **_HARD,
        **_seen_and_felt(),
    )


def _seen_and_felt() -> dict[str, int]:
    return {**collision(True), "group": collision(False)["group"]}
