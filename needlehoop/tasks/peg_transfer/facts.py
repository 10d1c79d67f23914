"""What is true of a moment: grasped, lifted, arrived, over, placed. Facts are geometry."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache, reduce

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.peg_transfer.scene import WALLS, PegLayout, PegRules, at_wall
from needlehoop.tasks.psm import hold

FACTS = (
    Fact("grasped", "the block is held", remembered=True, once=True),
    Fact("lifted", "the block's lower edge is above the marked peg's top", once=True),
    Fact(
        "arrived",
        "the block is at the marked peg, lower than its top: about it or beside it",
        verdict=True,
        once=True,
    ),
    Fact("over", "the marked peg's axis runs through the block's hole", verdict=True, once=True),
    Fact(
        "placed",
        "the block stands over the marked peg, on the board, released and at rest",
        verdict=True,
    ),
)


def observe(
    layout: PegLayout, rules: PegRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts, see ``contract.Task``."""
    r, position, quat = readings, readings["block_position"], readings["block_quat"]
    local = geo.rotate(quat.unsqueeze(1), _inside_walls(layout, quat.device))
    grasped, welds = hold(rules, memory, r, position.unsqueeze(1) + local, position, quat)
    low = lower_edge(layout, position, quat)
    near = geo.aside(position - r["goal"]) < rules.arrive_radius
    over = is_over(layout, position, quat, r["goal"])
    released = ~grasped & ~r["jaw_1_touch"] & ~r["jaw_2_touch"]
    upright = _vertical(quat)[2].abs() > math.cos(rules.rest_tilt)
    down = (position[:, 2] - r["goal"][:, 2]).abs() < rules.rest_gap
    slow = geo.dot(r["block_velocity"], r["block_velocity"]) < rules.rest_speed**2
    quiet = geo.dot(r["block_spin"], r["block_spin"]) < rules.rest_spin**2
    facts = {
        "grasped": grasped,
        "lifted": low > layout.marked_height,
        "arrived": near & (low < layout.marked_height),
        "over": over,
        "placed": over & released & upright & down & slow & quiet,
    }
    return facts, welds


def lower_edge(layout: PegLayout, position: Tensor, quat: Tensor) -> Tensor:
    """Height of the block's lowest corner ``(n,)``, m."""
    up_x, up_y, up_z = _vertical(quat)
    lowest = reduce(torch.minimum, [up_x * x + up_y * y for x, y in layout.corners.tolist()])
    return position[:, 2] + lowest - up_z.abs() * (layout.block_height / 2)


def is_over(layout: PegLayout, position: Tensor, quat: Tensor, goal: Tensor) -> Tensor:
    """Whether a vertical line through ``goal`` ``(n, 3)`` runs through the whole hole; bool.

    ``position`` ``(n, 3)``, m, and ``quat`` ``(n, 4)`` of the block's middle.
    """
    up_x, up_y, up_z = _vertical(quat)
    x, y, z = geo.rotate(geo.conjugate(quat), goal - position).unbind(-1)
    # A hole that lies flatter lets no peg through.
    through = up_z.abs() > 0.5
    slope = torch.where(through, up_z, torch.ones_like(up_z))
    for end in (-layout.block_height / 2, layout.block_height / 2):
        along = (end - z) / slope
        for angle in WALLS:
            out = math.cos(angle) * (x + along * up_x) + math.sin(angle) * (y + along * up_y)
            through = through & (out < layout.hole_radius)
    return through


def _vertical(quat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The world's z in the block's frame, by component ``(n,)``."""
    w, x, y, z = quat.unbind(-1)
    return 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@cache
def _inside_walls(layout: PegLayout, device: torch.device) -> Tensor:
    """Points in the middle of the walls ``(k, 3)``, block frame, 2 to 3 mm apart."""
    out, half = layout.hole_radius + layout.wall / 2, layout.wall_length / 2
    return torch.tensor(
        [
            (*at_wall(a, out, along * half), up * layout.block_height / 2)
            for a in WALLS
            for along in torch.linspace(-0.9, 0.9, 9).tolist()
            for up in torch.linspace(-0.9, 0.9, 7).tolist()
        ],
        dtype=torch.float64,
        device=device,
    )
