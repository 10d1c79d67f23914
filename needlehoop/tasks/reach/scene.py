"""Phantom, marks and target as MuJoCo bodies; and the table of signals."""

from __future__ import annotations

import mujoco

from needlehoop.scene.shapes import add_upright
from needlehoop.scene.signals import of_body, verdict
from needlehoop.scene.spec import Materials
from needlehoop.tasks.psm import signals
from needlehoop.tasks.reach.layout import ReachLayout, ReachRules

_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER

MATERIALS: Materials = {
    "phantom": ((0.80, 0.52, 0.46), 0.2, 0.3),
    "mark": ((0.25, 0.22, 0.50), 0.1, 0.2),
    "target": ((1.0, 0.86, 0.10), 0.2, 0.3),
}

SIGNALS = signals(
    {"target": of_body("position", "target", "point just above the middle of the button")},
    {
        "near": verdict("the point between the jaws is at the target"),
        "stayed": verdict("it has been there for as many steps as the task asks for"),
    },
)

_MARK = (-0.0010, 0.0005)
"""Lower and upper face of a mark, m above the top of its bump: flat, where the bump is round."""

_BUTTON = 0.0025
"""Thickness of the target's button, m."""

_STEM = 0.0015
"""Radius of what it stands on, m."""


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
        add_upright(bump, f"bump_{index}", capsule, (foot, -radius), radius, "phantom")
        mark = spec.worldbody.add_body(name=f"mark_{index}", pos=top, mocap=True)
        add_upright(
            mark, f"mark_{index}", _CYLINDER, _MARK, layout.mark_radius, "mark", solid=False
        )
    target = spec.worldbody.add_body(name="target", mocap=True)
    face, foot = -layout.clearance, -layout.target_above_bump
    size = layout.target_radius
    add_upright(target, "button", _CYLINDER, (face - _BUTTON, face), size, "target")
    add_upright(target, "stem", _CYLINDER, (foot - 0.001, face - _BUTTON), _STEM, "target")
