"""The phantom: its sizes, bodies and marks, where an episode begins, and what is true of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import mujoco
import torch
from torch import Tensor

from needlehoop.config.strict import Count, Range
from needlehoop.robot.geometry import distance
from needlehoop.scene.shapes import add_upright
from needlehoop.scene.spec import Materials
from needlehoop.tasks.contract import Fact, Memory, Weld
from needlehoop.tasks.layout import ArmLayout, Length, Place, Spread, ToolEpisode
from needlehoop.tasks.psm import servos, tool_start
from needlehoop.tasks.start import Chance, Start

BUMPS = 5
"""Bumps of the phantom; each has a mark on top, and one of them the target."""


@dataclass(frozen=True)
class ReachLayout(ArmLayout):
    """The phantom and where its bumps are; see ``Layout``."""

    bump_positions: tuple[tuple[Place, Place], ...]
    """Nominal x and y of each bump."""
    bump_radii: tuple[Length, ...]
    """Radius of each bump: a round column with the half of a sphere on top."""
    bump_position_range: tuple[Spread, Spread]
    bump_height: Length
    """Nominal height of a bump above the table. Each has a height of its own."""
    bump_height_range: Spread

    mark_radius: Length
    """Radius of the flat discs on top of the bumps."""
    target_radius: Length
    """Radius of the button that marks the target."""
    target_height: Length
    """Height of the button's upper face above the top of its bump."""
    clearance: Length
    """Height of the target point above the button: the jaws end before ``tool_midpoint``."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("bump_positions", "bump_radii"):
            count = len(getattr(self, key))
            if count != BUMPS:
                raise ValueError(f"task.{key}: {count} values; there are {BUMPS} bumps")

    @property
    def target_above_bump(self) -> float:
        """Height of the target point above the top of its bump."""
        return self.target_height + self.clearance


@dataclass(frozen=True)
class ReachRules(ToolEpisode):
    """When a fact of reach holds; values in ``conf/episode``."""

    near_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``near``: ``tool_midpoint`` is this near the target, m."""
    near_steps: Count
    """``stayed``: it has been near after so many steps, one after the other."""


MATERIALS: Materials = {
    "phantom": ((0.80, 0.52, 0.46), 0.2, 0.3),
    "mark": ((0.25, 0.22, 0.50), 0.1, 0.2),
    "target": ((1.0, 0.86, 0.10), 0.2, 0.3),
}


FACTS = (
    Fact(
        "near", "the point between the jaws is at the target", verdict=True, once=True, timed=True
    ),
    Fact("stayed", "it has been there for as many steps as the task asks for", verdict=True),
)


def build(spec: mujoco.MjSpec, layout: ReachLayout, rules: ReachRules) -> None:
    """Add bumps, marks and the target: mocap bodies, placed at reset.

    A bump's frame is at its top, a mark's as well, the target's at the target point.
    """
    for index, (x, y) in enumerate(layout.bump_positions):
        top, radius = [x, y, layout.bump_height], layout.bump_radii[index]
        bump = spec.worldbody.add_body(name=f"bump_{index}", pos=top, mocap=True)
        # As long as the highest bump is high: the rest is below the table.
        foot = -radius - layout.bump_height - layout.bump_height_range
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        add_upright(bump, f"bump_{index}", (foot, -radius), radius, "phantom", capsule)
        mark = spec.worldbody.add_body(name=f"mark_{index}", pos=top, mocap=True)
        # Flat, where the bump is round. Faces in m above the top of the bump.
        faces, radius = (-0.0010, 0.0005), layout.mark_radius
        add_upright(mark, f"mark_{index}", faces, radius, "mark", solid=False)
    target = spec.worldbody.add_body(name="target", mocap=True)
    face, foot = -layout.clearance, -layout.target_above_bump
    under, radius = face - 0.0025, layout.target_radius
    add_upright(target, "button", (under, face), radius, "target")
    add_upright(target, "stem", (foot - 0.001, under), 0.0015, "target")


def start(layout: ReachLayout, chance: Chance) -> Start:
    """Scatter bumps and tool over the layout's ranges, and choose the target's bump."""
    half = (*layout.bump_position_range, layout.bump_height_range)
    tops = torch.stack(
        [chance.place((*at, layout.bump_height), half) for at in layout.bump_positions], 1
    )
    chosen = (BUMPS * chance.number()).long()
    up = torch.tensor((0.0, 0.0, layout.target_above_bump), dtype=tops.dtype)
    places = {"target": tops[torch.arange(len(tops)), chosen] + up}
    for index in range(BUMPS):
        places[f"bump_{index}"] = places[f"mark_{index}"] = tops[:, index]
    robot = tool_start(layout, chance)
    return Start(robot, free={}, mocap=places, control=servos(robot))


def observe(
    layout: ReachLayout, rules: ReachRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Near, and stayed: see ``contract.Task``."""
    near = distance(readings["tool_midpoint"], readings["target"]) < rules.near_radius
    lasted = memory["steps"] - memory["near_since"]
    return {"near": near, "stayed": near & (lasted >= rules.near_steps)}, {}
