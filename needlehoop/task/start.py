"""Where an episode begins: needle, hoop and tool, scattered over the layout's ranges."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorClass
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.layout import Layout
from needlehoop.task.reach import tip_joints

DRAWS = 9
"""Uniform numbers that one reset consumes."""

_SUNK = 1.25e-6
"""How deep a needle at rest sinks into the table, m (measured). Laid exactly on the
surface, rounding decides which of its contacts exist, and the rest kick it."""


class Start(TensorClass):
    """Where things are when an episode begins.

    ``tool`` ``(n, 3)`` is ``tool_midpoint``; ``joints`` ``(n, 6)``, ``jaw`` ``(n,)``,
    ``needle`` ``(n, 7)`` (position, quaternion), ``hoop`` and ``lift`` ``(n, 3)``; m, rad,
    world frame.
    """

    tool: Tensor
    joints: Tensor
    jaw: Tensor
    needle: Tensor
    hoop: Tensor
    lift: Tensor


def draws(seed: int, env: int, episode: int) -> np.ndarray:
    """The uniform numbers ``(DRAWS,)`` of one episode of one environment.

    Counter-based: they depend on nothing but the three arguments, so an episode is the
    same whatever else runs beside it.
    """
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(env, episode))
    return np.random.Generator(np.random.Philox(sequence)).random(DRAWS)


def start(layout: Layout, uniform: Tensor) -> Start:
    """Scatter needle, hoop and tool over the layout's ranges.

    Args:
        layout: nominal placement and ranges.
        uniform: numbers in [0, 1) ``(n, DRAWS)``, float64.
    """
    spread = 2.0 * uniform - 1.0

    def scatter(nominal: tuple[float, ...], half: tuple[float, ...], at: int) -> Tensor:
        columns = [
            c + h * spread[:, at + i] for i, (c, h) in enumerate(zip(nominal, half, strict=True))
        ]
        return torch.stack(columns, -1)

    needle_xy = scatter(layout.needle_position, layout.needle_position_range, 0)
    yaw = layout.needle_yaw + layout.needle_yaw_range * spread[:, 2]
    hoop = scatter(layout.hoop_position, layout.hoop_position_range, 3)
    tool = scatter(layout.tool_position, layout.tool_position_range, 6)
    height = torch.full_like(needle_xy[:, :1], layout.needle_thickness / 2 - _SUNK)
    roll = torch.full_like(yaw, layout.tool_roll)
    return Start(
        tool=tool,
        joints=tip_joints(layout, tool, roll),
        jaw=torch.full_like(yaw, layout.tool_jaw),
        needle=torch.cat((needle_xy, height, geo.about_z(yaw)), -1),
        hoop=hoop,
        lift=torch.cat((needle_xy, hoop[:, 2:]), -1),
        batch_size=[len(uniform)],
    )
