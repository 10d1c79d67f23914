"""The scene: table, PSM, needle, hoop, cameras and named sensors as one MjSpec.

World frame: z up, origin on the table under the remote centre of motion, y pointing
away from the front camera (into the hoop), x to that camera's right. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from needlehoop.robot.arm import add_arm
from needlehoop.robot.joints import JOINT_NAMES
from needlehoop.robot.shapes import Mesh, collision, torus, tube
from needlehoop.scene.cameras import View, pose_of
from needlehoop.scene.layout import Layout

NEEDLE_SEGMENTS = 7
HOOP_SEGMENTS = 16

Materials = Mapping[str, tuple[tuple[float, float, float], float, float]]
"""RGB, specular and shininess by name."""

_MATERIALS: Materials = {
    "table": ((0.13, 0.36, 0.40), 0.05, 0.1),
    "needle": ((0.93, 0.94, 0.97), 0.9, 0.7),
    "hoop": ((0.93, 0.47, 0.13), 0.4, 0.4),
    "stand": ((0.88, 0.88, 0.90), 0.2, 0.3),
}
_ARM_MATERIALS: Materials = {
    "arm_light": ((0.80, 0.81, 0.83), 0.3, 0.4),
    "arm_dark": ((0.27, 0.29, 0.33), 0.3, 0.4),
    "instrument": ((0.50, 0.53, 0.60), 0.3, 0.4),
    "shaft": ((0.15, 0.15, 0.17), 0.5, 0.6),
    "steel": ((0.58, 0.60, 0.64), 0.8, 0.6),
    "jaw": ((0.73, 0.75, 0.79), 0.9, 0.7),
}


class SensorSpec(NamedTuple):
    """A named sensor: its MuJoCo type, the kind and name of the object it reads."""

    type: mujoco.mjtSensor
    objtype: mujoco.mjtObj
    objname: str


_SENS, _OBJ = mujoco.mjtSensor, mujoco.mjtObj

SENSORS: dict[str, SensorSpec] = {
    "tool_midpoint": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_SITE, "tool_midpoint"),
    "tool_quat": SensorSpec(_SENS.mjSENS_FRAMEQUAT, _OBJ.mjOBJ_SITE, "tool"),
    "wrist_pos": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_XBODY, "wrist_yaw"),
    "wrist_quat": SensorSpec(_SENS.mjSENS_FRAMEQUAT, _OBJ.mjOBJ_XBODY, "wrist_yaw"),
    "pickup_point": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_SITE, "pickup_point"),
    "needle_tip": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_SITE, "needle_tip"),
    "needle_quat": SensorSpec(_SENS.mjSENS_FRAMEQUAT, _OBJ.mjOBJ_SITE, "pickup_point"),
    "goal": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_SITE, "goal"),
    "hoop_axis": SensorSpec(_SENS.mjSENS_FRAMEZAXIS, _OBJ.mjOBJ_SITE, "goal"),
    "lift_position": SensorSpec(_SENS.mjSENS_FRAMEPOS, _OBJ.mjOBJ_XBODY, "lift_position"),
    **{name: SensorSpec(_SENS.mjSENS_JOINTPOS, _OBJ.mjOBJ_JOINT, name) for name in JOINT_NAMES},
    "jaw": SensorSpec(_SENS.mjSENS_TENDONPOS, _OBJ.mjOBJ_TENDON, "jaw"),
    "jaw_1_touch": SensorSpec(_SENS.mjSENS_CONTACT, _OBJ.mjOBJ_GEOM, "jaw_1_pad"),
    "jaw_2_touch": SensorSpec(_SENS.mjSENS_CONTACT, _OBJ.mjOBJ_GEOM, "jaw_2_pad"),
}
"""Every sensor of the scene, in the order of ``sensordata``."""


def build_spec(layout: Layout, psm: str, grasp: str, views: Mapping[str, View]) -> mujoco.MjSpec:
    """The whole scene, ready to compile.

    Args:
        layout: sizes and placement.
        psm: arm variant, see ``joints.VARIANTS``.
        grasp: ``weld`` adds the (inactive) weld ``grasp`` between wrist and needle;
            ``friction`` has contacts only.
        views: cameras to add, by name.
    """
    spec = _begin("needlehoop", layout, {**_MATERIALS, **_ARM_MATERIALS})
    _add_table(spec)
    add_arm(spec, layout.rcm, psm, layout.grip)
    _add_needle(spec, layout)
    _add_hoop(spec, layout)
    if grasp == "weld":
        spec.add_equality(
            name="grasp",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="wrist_yaw",
            name2="needle",
            active=False,
            solref=[0.004, 1.0],
            solimp=[0.99, 0.999, 0.0001, 0.5, 2.0],
        )
    for name, view in views.items():
        position, quaternion = pose_of(view)
        spec.worldbody.add_camera(name=name, pos=position, quat=quaternion, fovy=view.fovy)
    _add_sensors(spec)
    return spec


def build_arm(layout: Layout, psm: str) -> mujoco.MjSpec:
    """The arm alone, ready to compile; its RCM is the world's origin.

    Args:
        layout: the physics' step, and where ``tool_midpoint`` is.
        psm: arm variant, see ``arm.VARIANTS``.
    """
    spec = _begin("psm", layout, _ARM_MATERIALS)
    add_arm(spec, np.zeros(3), psm, layout.grip)
    # All of it, from the tip to the motors.
    spec.stat.extent = 1.0
    spec.stat.center = [0.0, 0.35, 0.15]
    return spec


def _begin(name: str, layout: Layout, materials: Materials) -> mujoco.MjSpec:
    """A scene with physics, a lamp and materials, and nothing in it."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    _set_physics(spec, layout)
    for material, (rgb, specular, shininess) in materials.items():
        spec.add_material(name=material, rgba=[*rgb, 1.0], specular=specular, shininess=shininess)
    return spec


def _set_physics(spec: mujoco.MjSpec, layout: Layout) -> None:
    option = spec.option
    option.timestep = layout.timestep
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


def _add_table(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 0.05],
        material="table",
        friction=[0.8, 0.002, 0.0001],
        solref=[0.004, 1.0],
    )


def _add_needle(spec: mujoco.MjSpec, layout: Layout) -> None:
    """A free body whose frame sits at the pickup point."""
    tail, tip = layout.needle_angles
    height = layout.needle_thickness / 2
    x, y = layout.needle_position
    half_yaw = layout.needle_yaw / 2
    body = spec.worldbody.add_body(
        name="needle", pos=[x, y, height], quat=[np.cos(half_yaw), 0, 0, np.sin(half_yaw)]
    )
    body.add_freejoint(name="needle")
    mesh = tube(layout.centre_line(np.linspace(tail, tip, 15)), height, taper=0.12)
    _add_mesh(spec, body, "needle", mesh, "needle")
    ends = layout.centre_line(np.linspace(tail, tip, NEEDLE_SEGMENTS + 1))
    for index, (start, end) in enumerate(pairwise(ends)):
        body.add_geom(
            name=f"needle_{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=np.concatenate((start, end)),
            size=[height, 0, 0],
            mass=layout.needle_mass / NEEDLE_SEGMENTS,
            friction=[0.8, 0.002, 0.0001],
            solref=[0.004, 1.0],
            **collision(True),
        )
    body.add_site(name="pickup_point", size=[0.001] * 3)
    body.add_site(name="needle_tip", pos=ends[-1], size=[0.001] * 3)


def _add_hoop(spec: mujoco.MjSpec, layout: Layout) -> None:
    """A ring on a telescopic stand; both are mocap bodies, placed at reset."""
    centre = np.array(layout.hoop_position)
    radius, thick = layout.hoop_opening + layout.hoop_tube, layout.hoop_tube
    stand = spec.worldbody.add_body(name="stand", pos=[*centre[:2], 0.0], mocap=True)
    sleeve = centre[2] - layout.hoop_position_range[2] - radius - 0.006
    for name, low, high, size in (("base", 0.0, 0.003, 0.009), ("sleeve", 0.0, sleeve, 0.0032)):
        _add_post(stand, f"stand_{name}", low, high, size, "stand")
    hoop = spec.worldbody.add_body(name="hoop", pos=centre, mocap=True)
    # Long enough to stay inside the sleeve at any height.
    _add_post(hoop, "hoop_rod", sleeve / 2 - centre[2], -radius, 0.0016, "stand")
    _add_mesh(spec, hoop, "hoop", torus(radius, thick), "hoop")
    angles = np.linspace(0.0, 2 * np.pi, HOOP_SEGMENTS + 1)
    # Chords would cut into the opening: their mid-points lie on the ring instead.
    outer = radius / np.cos(np.pi / HOOP_SEGMENTS)
    ring = outer * np.stack((np.cos(angles), np.zeros_like(angles), np.sin(angles)), -1)
    for index, (start, end) in enumerate(pairwise(ring)):
        hoop.add_geom(
            name=f"hoop_{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=np.concatenate((start, end)),
            size=[thick, 0, 0],
            friction=[0.3, 0.002, 0.0001],
            solref=[0.004, 1.0],
            **collision(True),
        )
    quarter = np.sqrt(0.5)
    # The site's z axis is the hoop's axis: the world's y.
    hoop.add_site(name="goal", quat=[quarter, -quarter, 0, 0], size=[0.001] * 3)
    spec.worldbody.add_body(name="lift_position", mocap=True)


def _add_post(
    body: mujoco.MjsBody, name: str, low: float, high: float, radius: float, material: str
) -> None:
    shape = {
        "type": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "fromto": [0, 0, low, 0, 0, high],
        "size": [radius, 0, 0],
    }
    body.add_geom(name=name, material=material, **shape, **collision(False))
    body.add_geom(name=f"{name}_solid", solref=[0.004, 1.0], **shape, **collision(True))


def _add_mesh(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, mesh: Mesh, material: str
) -> None:
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


def _add_sensors(spec: mujoco.MjSpec) -> None:
    for name, sensor in SENSORS.items():
        added = spec.add_sensor(
            name=name, type=sensor.type, objtype=sensor.objtype, objname=sensor.objname
        )
        if sensor.type == mujoco.mjtSensor.mjSENS_CONTACT:
            added.reftype, added.refname = mujoco.mjtObj.mjOBJ_BODY, "needle"
            # Report only whether a contact was found, one slot.
            added.intprm[:3] = [1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1]
