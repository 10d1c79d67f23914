"""Where an episode begins: which pegs, and board, block and tool scattered over their ranges."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.tasks.peg_transfer.layout import PegLayout
from needlehoop.tasks.peg_transfer.scene import OTHER_PEGS
from needlehoop.tasks.psm import begun, tool_start
from needlehoop.tasks.start import Start, scatter, standing

DRAWS = 10
"""Uniform numbers that one reset consumes."""

_SUNK = 2.82e-7
"""How deep a block at rest sinks into the table, m (measured)."""


def start(layout: PegLayout, uniform: Tensor) -> Start:
    """Draw the block's peg and the marked one; scatter board, block and tool.

    Args:
        layout: nominal placement and ranges.
        uniform: numbers in [0, 1) ``(n, DRAWS)``, float64.
    """
    begins, marked = _choose(layout, uniform[:, 0], uniform[:, 1])
    shift = scatter(uniform[:, 2:4], (0.0, 0.0), layout.board_range)
    yaw = scatter(uniform[:, 4:5], [layout.block_yaw], [layout.block_yaw_range])[:, 0]
    off = scatter(uniform[:, 5:7], (0.0, 0.0), layout.block_position_range)
    places = torch.tensor(layout.pegs, dtype=torch.float64)
    block = standing(places[begins] + shift + off, layout.block_height / 2 - _SUNK, yaw)
    return place(layout, tool_start(layout, uniform[:, 7:10]), block, shift, marked)


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
