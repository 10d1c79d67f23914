"""From settings to an environment: the scene, its engine, its images."""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop import rewards
from needlehoop.disturbances.disturbance import Disturbance
from needlehoop.disturbances.optics import add_objects
from needlehoop.envs.images import Imager, channels_of, things
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.scene.signals import sensors_of
from needlehoop.scene.spec import add_camera, add_materials, add_sensors, add_table, furnish

PICTURE = "picture"
"""Name of the camera that pictures for people are taken with."""


def scene_spec(settings: Settings) -> mujoco.MjSpec:
    """The scene to compile: robot, table, lights, sensors, the task's bodies, all cameras."""
    s, task = settings, settings.definition
    spec = task.robot.model(s.task, s.psm)
    spec.modelname = "needlehoop"
    furnish(spec, s.task.timestep)
    add_table(spec)
    add_materials(spec, task.materials)
    task.build(spec, s.task, s.episode)
    for name, view in s.views.items():
        add_camera(spec, name, view, f"views.{name}")
    add_camera(spec, PICTURE, s.picture, PICTURE)
    add_sensors(spec, sensors_of(task.signals))
    add_objects(spec, int(s.disturb.amounts.get("scene.objects", 0)))
    return spec


def build(settings: Settings, first_env: int = 0) -> Simulation:
    """A simulation of the settings; ``ValueError`` for settings that do not go together.

    ``first_env``: index of the first environment among all that share the seed.
    """
    s, task = settings, settings.definition
    model = scene_spec(s).compile()
    imager = Imager(model, s, s.engine.cpus)
    if s.engine.kind == "dm_control":
        # Imported where it is asked for: dm_control takes a while.
        from needlehoop.engines.dm_control import DmControlEngine as Kind
    elif s.engine.kind == "warp":
        from needlehoop.engines.warp_engine import WarpEngine as Kind
    else:
        from needlehoop.engines.engine import CpuEngine as Kind
    engine = Kind(
        model=model,
        robot=task.robot,
        num_envs=s.num_envs,
        substeps=s.episode.substeps,
        views=channels_of(s),
        size=s.image_size,
        quality=s.quality,
        config=s.engine,
    )
    disturbance = None
    if amounts := s.disturb.amounts:
        views = tuple(dict.fromkeys(camera.view for camera in s.cameras))
        # What the views in the room look at; without such views, what the pictures do.
        room = [s.views[name] for name in views if s.views[name].body is None]
        middle = np.mean([view.focus for view in room or [s.picture]], 0)
        disturbance = Disturbance(
            amounts=amounts,
            model=model,
            things=things(model, task.paint),
            views=views,
            target=middle,
            size=s.image_size,
            max_steps=s.episode.max_steps,
            num_envs=s.num_envs,
            device=engine.device,
        )
    reward = rewards.load(s.reward, task)
    return Simulation(s, engine, imager, reward, first_env, disturbance)
