"""A task's whole scene as one MjSpec."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from needlehoop.scene.cameras import View
from needlehoop.scene.signals import sensors_of
from needlehoop.scene.spec import TABLE, add_cameras, add_sensors, add_table, begin_spec
from needlehoop.tasks.contract import Task
from needlehoop.tasks.episode import Episode
from needlehoop.tasks.layout import Layout


def build_spec(
    task: Task, layout: Layout, rules: Episode, psm: str, views: Mapping[str, View]
) -> mujoco.MjSpec:
    """The scene, ready to compile: robot, table, lights, cameras, sensors and what the task adds.

    Args:
        task: whose scene it is.
        layout: its sizes and placement.
        rules: its rules; how things are grasped decides on welds.
        psm: arm variant, see ``joints.VARIANTS``.
        views: cameras to add, by name.
    """
    materials = {**TABLE, **task.materials, **task.robot.materials}
    spec = begin_spec("needlehoop", layout.timestep, materials)
    add_table(spec)
    task.robot.add(spec, layout, psm)
    task.build(spec, layout, rules)
    add_cameras(spec, views)
    add_sensors(spec, sensors_of(task.signals))
    return spec
