"""Needle, hoop and its stand: sizes, bodies, what is sensed, where an episode begins, the rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.config.strict import OneOf, Range
from needlehoop.scene.shapes import add_mesh, add_upright, torus
from needlehoop.scene.signals import of_body, of_site
from needlehoop.scene.spec import Materials
from needlehoop.tasks.layout import ArmEpisode, ArmLayout, Length, Place, Spread
from needlehoop.tasks.needle_hoop.needle import Needle, add_chain, add_needle, lying
from needlehoop.tasks.psm import add_grasp, servos, tool_start
from needlehoop.tasks.start import Chance, Start


@dataclass(frozen=True)
class NeedleLayout(Needle, ArmLayout):
    """Needle, hoop and where they are; see ``Layout``."""

    hoop_opening: Length
    """Radius of the free opening."""
    hoop_tube: Length
    """Radius of the ring's cross-section."""
    hoop_position: tuple[Place, Place, Place]
    """Nominal centre of the opening; the hoop's axis is the world's y."""
    hoop_position_range: tuple[Spread, Spread, Spread]


@dataclass(frozen=True)
class NeedleRules(ArmEpisode):
    """When a fact of needle and hoop holds, and what success is; values in ``conf/episode``."""

    lift_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``lifted``: the pickup point came this near the lift position, m."""
    goal_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``touched``: the tip is this near the goal, m."""
    thread_depth: Annotated[float, Range(-1.0, 1.0)]
    """``threaded``: the tip is at least this far beyond the hoop's plane, m."""
    success: Annotated[str, OneOf("thread", "touch")] = "thread"
    """``thread``: the needle is through the hoop. ``touch``: its tip is at the goal, as in the
    paper."""


MATERIALS: Materials = {
    "needle": ((0.93, 0.94, 0.97), 0.9, 0.7),
    "hoop": ((0.93, 0.47, 0.13), 0.4, 0.4),
    "stand": ((0.88, 0.88, 0.90), 0.2, 0.3),
}

THINGS = {
    "pickup_point": of_site("position", "pickup_point", "where the needle should be grasped"),
    "needle_tip": of_site("position", "needle_tip", "the needle's sharp end"),
    "needle_quat": of_site(
        "orientation",
        "pickup_point",
        "needle frame at the pickup point: y towards the sharp end, x towards the arc's centre",
    ),
    "goal": of_site("position", "goal", "centre of the hoop's opening"),
    "hoop_axis": of_site("axis", "goal", "unit vector through the opening: the world's y"),
    "lift_position": of_body(
        "position", "lift_position", "above the pickup point's start, at the goal's height"
    ),
}


def build(spec: mujoco.MjSpec, layout: NeedleLayout, rules: NeedleRules) -> None:
    """Add needle and hoop, and what ``episode.grasp`` holds the needle with."""
    needle = add_needle(spec, layout)
    tip = layout.centre_line(np.array(layout.needle_angles))[1]
    needle.add_site(name="pickup_point", size=[0.001] * 3)
    needle.add_site(name="needle_tip", pos=tip, size=[0.001] * 3)
    _add_hoop(spec, layout)
    add_grasp(spec, rules, "needle", solref=[0.004, 1.0], solimp=[0.99, 0.999, 0.0001, 0.5, 2.0])


def _add_hoop(spec: mujoco.MjSpec, layout: NeedleLayout) -> None:
    """A ring on a telescopic stand; both are mocap bodies, placed at reset."""
    centre = np.array(layout.hoop_position)
    radius, thick = layout.hoop_opening + layout.hoop_tube, layout.hoop_tube
    stand = spec.worldbody.add_body(name="stand", pos=[*centre[:2], 0.0], mocap=True)
    sleeve = centre[2] - layout.hoop_position_range[2] - radius - 0.006
    for name, low, high, size in (("base", 0.0, 0.003, 0.009), ("sleeve", 0.0, sleeve, 0.0032)):
        add_upright(stand, f"stand_{name}", (low, high), size, "stand")
    hoop = spec.worldbody.add_body(name="hoop", pos=centre, mocap=True)
    # Long enough to stay inside the sleeve at any height.
    ends = (sleeve / 2 - centre[2], -radius)
    add_upright(hoop, "hoop_rod", ends, 0.0016, "stand")
    add_mesh(spec, hoop, "hoop", torus(radius, thick), "hoop")
    segments = 16
    angles = np.linspace(0.0, 2 * np.pi, segments + 1)
    # Chords would cut into the opening: their mid-points lie on the ring instead.
    outer = radius / np.cos(np.pi / segments)
    ring = outer * np.stack((np.cos(angles), np.zeros_like(angles), np.sin(angles)), -1)
    add_chain(hoop, ring, thick, 0.3)
    quarter = np.sqrt(0.5)
    # The site's z axis is the hoop's axis: the world's y.
    hoop.add_site(name="goal", quat=[quarter, -quarter, 0, 0], size=[0.001] * 3)
    spec.worldbody.add_body(name="lift_position", mocap=True)


def start(layout: NeedleLayout, chance: Chance) -> Start:
    """Scatter needle, hoop and tool over the layout's ranges."""
    needle_xy = chance.place(layout.needle_position, layout.needle_position_range)
    yaw = chance.about(layout.needle_yaw, layout.needle_yaw_range)
    hoop = chance.place(layout.hoop_position, layout.hoop_position_range)
    return place(tool_start(layout, chance), lying(layout, needle_xy, yaw), hoop)


def place(robot: dict[str, Tensor], needle: Tensor, hoop: Tensor) -> Start:
    """A start from the robot's own, the needle's pose ``(n, 7)`` and the hoop's centre ``(n, 3)``.

    The lift position is above the needle, at the hoop's height.
    """
    stand = torch.cat((hoop[:, :2], torch.zeros_like(hoop[:, :1])), -1)
    lift = torch.cat((needle[:, :2], hoop[:, 2:]), -1)
    places = {"stand": stand, "hoop": hoop, "lift_position": lift}
    return Start(robot, free={"needle": needle}, mocap=places, control=servos(robot))
