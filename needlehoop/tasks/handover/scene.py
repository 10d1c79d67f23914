"""Two arms and a needle: what there is, what is sensed, where an episode begins, the rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import mujoco
import numpy as np
import torch

from needlehoop.config.strict import Count, Range
from needlehoop.scene.signals import of_site
from needlehoop.scene.spec import Materials
from needlehoop.tasks.arms import by_arm
from needlehoop.tasks.layout import ArmAside, ArmEpisode, Layout, Place
from needlehoop.tasks.needle_hoop.needle import Needle, add_needle, lying
from needlehoop.tasks.psm import add_grasp, servos, tool_start
from needlehoop.tasks.start import Chance, Start

ARMS = {"psm1": "PSM 1", "psm2": "PSM 2"}
"""The first takes the needle off the table, the second takes it from the first."""


@dataclass(frozen=True)
class HandoverLayout(Needle, Layout):
    """The needle, whose pickup point is its middle, and two arms; see ``Layout``."""

    meeting: tuple[Place, Place, Place]
    """Where the needle's middle is to be when it changes hands."""
    psm1: ArmAside
    psm2: ArmAside

    @property
    def thirds(self) -> tuple[float, float]:
        """Arc angles of the points a third from the tail, and a third from the tip."""
        tail, tip = self.needle_angles
        return (2 * tail + tip) / 3, (tail + 2 * tip) / 3


@dataclass(frozen=True)
class HandoverRules(ArmEpisode):
    """When a fact of the handover holds; values in ``conf/episode``. Each arm has the control."""

    CONTROLS: ClassVar[dict[str, int]] = {
        name: 2 * size for name, size in ArmEpisode.CONTROLS.items()
    }

    lift_height: Annotated[float, Range(0.0, 1.0, above=True)]
    """``lifted``: the needle's lowest point is this high above the table, m."""
    hold_steps: Count
    """``handed``: the second arm has held it alone, lifted, for so many steps in a row."""


MATERIALS: Materials = {"needle": ((0.93, 0.94, 0.97), 0.9, 0.7)}

THINGS = {
    "pickup_1": of_site(
        "position", "pickup_1", "where PSM 1 should grasp the needle: a third of it from its tail"
    ),
    "pickup_2": of_site(
        "position", "pickup_2", "where PSM 2 should grasp it: a third of it from its sharp end"
    ),
    "needle_middle": of_site("position", "needle_middle", "the middle of the needle's arc"),
    "needle_quat": of_site(
        "orientation",
        "needle_middle",
        "needle frame in its middle: y towards the sharp end, x towards the arc's centre",
    ),
    "meeting": of_site(
        "position", "meeting", "where the needle's middle should be when it changes hands"
    ),
}


def build(spec: mujoco.MjSpec, layout: HandoverLayout, rules: HandoverRules) -> None:
    """Add the needle, and what ``episode.grasp`` holds it with in either arm's jaws."""
    needle = add_needle(spec, layout)
    needle.add_site(name="needle_middle", size=[0.001] * 3)
    for name, place in zip(
        ("pickup_1", "pickup_2"), layout.centre_line(np.array(layout.thirds)), strict=True
    ):
        needle.add_site(name=name, pos=place, size=[0.001] * 3)
    spec.worldbody.add_site(name="meeting", pos=layout.meeting, size=[0.001] * 3)
    for name in ARMS:
        softness = {"solref": [0.004, 1.0], "solimp": [0.99, 0.999, 0.0001, 0.5, 2.0]}
        add_grasp(spec, rules, "needle", prefix=f"{name}_", **softness)


def start(layout: HandoverLayout, chance: Chance) -> Start:
    """Scatter the needle and both tools over the layout's ranges."""
    place = chance.place(layout.needle_position, layout.needle_position_range)
    yaw = chance.about(layout.needle_yaw, layout.needle_yaw_range)
    arms = {name: tool_start(getattr(layout, name), chance) for name in ARMS}
    control = torch.cat([servos(one) for one in arms.values()], -1)
    needle = lying(layout, place, yaw)
    return Start(by_arm(arms), free={"needle": needle}, mocap={}, control=control)
