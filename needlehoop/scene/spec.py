"""The scene that all tasks share: physics, lamp, table, cameras and named sensors, as MjSpec parts.

World frame: z up, origin on the table, y pointing away from the front camera, x to that camera's
right. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from needlehoop.config.strict import check_names
from needlehoop.scene.cameras import View, pose_of
from needlehoop.scene.signals import Sensor

Materials = Mapping[str, tuple[tuple[float, float, float], float, float]]
"""RGB, specular and shininess by name."""


def furnish(spec: mujoco.MjSpec, timestep: float) -> None:
    """Give a robot's spec the physics and the lamp of a scene; ``timestep`` in s.

    What its file says of physics is replaced.
    """
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    option.iterations = 20
    option.ls_iterations = 20
    # The arm is far larger than what the cameras look at.
    spec.stat.extent = 0.5
    spec.stat.center = [0.0, 0.0, 0.05]
    spec.visual.map.znear = 0.01
    spec.visual.headlight.ambient = [0.38] * 3
    spec.visual.headlight.diffuse = [0.22] * 3
    spec.visual.headlight.specular = [0.1] * 3
    spec.visual.global_.offwidth = 1920
    spec.visual.global_.offheight = 1080
    spec.worldbody.add_light(
        name="key",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-0.3, -0.4, 0.9],
        dir=[0.35, 0.45, -0.85],
        diffuse=[0.55] * 3,
        specular=[0.35] * 3,
        castshadow=True,
    )


def add_materials(spec: mujoco.MjSpec, materials: Materials) -> None:
    """Materials by their names."""
    for name, (rgb, specular, shininess) in materials.items():
        spec.add_material(name=name, rgba=[*rgb, 1.0], specular=specular, shininess=shininess)


def add_table(spec: mujoco.MjSpec) -> None:
    """The table: the plane z = 0."""
    add_materials(spec, {"table": ((0.13, 0.36, 0.40), 0.05, 0.1)})
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 0.05],
        material="table",
        friction=[0.8, 0.002, 0.0001],
        solref=[0.004, 1.0],
    )


def add_camera(spec: mujoco.MjSpec, name: str, view: View, key: str) -> None:
    """A view's camera, in the room or on its body; the scene has all its bodies by now.

    Raises:
        ValueError: there is no such body; names the setting, which begins with ``key``.
    """
    carrier = spec.worldbody
    if view.body is not None:
        check_names(f"{key}.body", [view.body], [one.name for one in spec.bodies[1:]])
        carrier = spec.body(view.body)
    position, quaternion = pose_of(view)
    carrier.add_camera(name=name, pos=position, quat=quaternion, fovy=view.fovy)


def add_sensors(spec: mujoco.MjSpec, sensors: Mapping[str, Sensor]) -> None:
    """Named sensors, in the order of ``sensordata``."""
    for name, sensor in sensors.items():
        added = spec.add_sensor(
            name=name, type=sensor.type, objtype=sensor.objtype, objname=sensor.objname
        )
        if sensor.type == mujoco.mjtSensor.mjSENS_CONTACT:
            added.reftype, added.refname = mujoco.mjtObj.mjOBJ_BODY, sensor.body
            # Report only whether a contact was found, one slot.
            added.intprm[:3] = [1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1]
