"""The scene that all tasks share: physics, lamp, table, cameras and named sensors, as MjSpec parts.

World frame: z up, origin on the table, y pointing away from the front camera, x to that camera's
right. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco

from needlehoop.robot.shapes import Mesh, collision
from needlehoop.scene.cameras import View, pose_of
from needlehoop.scene.signals import Sensor

Materials = Mapping[str, tuple[tuple[float, float, float], float, float]]
"""RGB, specular and shininess by name."""

TABLE: Materials = {"table": ((0.13, 0.36, 0.40), 0.05, 0.1)}


def begin_spec(name: str, timestep: float, materials: Materials) -> mujoco.MjSpec:
    """A scene with physics, a lamp and materials, and nothing in it.

    Args:
        name: of the model.
        timestep: physics step, s.
        materials: by name.
    """
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    _set_physics(spec, timestep)
    for material, (rgb, specular, shininess) in materials.items():
        spec.add_material(name=material, rgba=[*rgb, 1.0], specular=specular, shininess=shininess)
    return spec


def add_table(spec: mujoco.MjSpec) -> None:
    """The table: the plane z = 0."""
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 0.05],
        material="table",
        friction=[0.8, 0.002, 0.0001],
        solref=[0.004, 1.0],
    )


def attach(spec: mujoco.MjSpec, file: Path, prefix: str) -> None:
    """Add what an MJCF file has; ``prefix`` goes before its names."""
    part = mujoco.MjSpec.from_file(str(file))
    spec.attach(part, prefix=prefix, frame=spec.worldbody.add_frame())


def add_cameras(spec: mujoco.MjSpec, views: Mapping[str, View]) -> None:
    """A camera for each view, by its name."""
    for name, view in views.items():
        position, quaternion = pose_of(view)
        spec.worldbody.add_camera(name=name, pos=position, quat=quaternion, fovy=view.fovy)


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


def add_mesh(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, mesh: Mesh, material: str
) -> None:
    """A mesh that is seen and touches nothing, the geom ``<name>_shape`` of a body."""
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    body.add_geom(
        name=f"{name}_shape",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=material,
        mass=0.0,
        **collision(False),
    )


def add_upright(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    heights: tuple[float, float],
    radius: float,
    material: str,
    solid: bool = True,
) -> None:
    """A cylinder or capsule along z that is seen; and ``<name>_solid``, felt, if it is solid.

    ``heights``: of its lower and upper end in the body's frame, m.
    """
    low, high = heights
    shape = {"type": kind, "fromto": [0, 0, low, 0, 0, high], "size": [radius, 0, 0]}
    body.add_geom(name=name, material=material, **shape, **collision(False))
    if solid:
        body.add_geom(name=f"{name}_solid", solref=[0.004, 1.0], **shape, **collision(True))


def _set_physics(spec: mujoco.MjSpec, timestep: float) -> None:
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
