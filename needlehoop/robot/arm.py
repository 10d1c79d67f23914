"""The PSM as a MuJoCo model: bodies, joints, servos, shapes.

Every body's frame is its joint's DH frame (``psm.JOINTS``), so the compiled model and
``psm.forward_kinematics`` are one chain. Shapes are drawn in *home coordinates*: the
RCM frame with all joints at zero. They are our own primitives and generated meshes.

Two variants move the tool alike: ``parallelogram`` has the closed linkage that holds
the remote centre on the real arm; ``serial`` pitches one rigid link about the RCM and
carries the linkage's inertia as armature.
"""

from __future__ import annotations

import mujoco
import numpy as np

from needlehoop.robot import psm
from needlehoop.robot.parallelogram import (
    MASS,
    MIMIC,
    add_linkage,
    carry_linkage_inertia,
    pivots,
)
from needlehoop.robot.shapes import Z_AXIS, Link, add_joint, collision

_JAW_ARMATURE = 6e-5
"""Rotor inertia that each jaw carries, kg m^2; see ``shapes.TOOL_ARMATURE``."""

# Natural frequencies of the critically damped position servos, rad/s. The effort limits
# of yaw and pitch bound theirs: stiffer, and a stop from full speed overshoots.
_BANDWIDTH = {"yaw": 50.0, "pitch": 50.0, "insertion": 100.0}
_TOOL_BANDWIDTH = 60.0

_SHAFT_RADIUS = 0.0042
_SHAFT_TOP = 0.43


def add_arm(spec: mujoco.MjSpec, rcm: np.ndarray, variant: str, grip: float) -> None:
    """Add the arm to a scene.

    Bodies: ``yaw`` … ``wrist_yaw``, ``jaw_1``, ``jaw_2``. Joints carry the names of
    ``psm.JOINTS`` and ``jaw_1``, ``jaw_2``. Actuators: those six and ``jaw``. Site
    ``tool_midpoint`` lies between the blades.

    Args:
        spec: the scene; materials must exist already.
        rcm: position of the RCM in the world frame, m. Its axes are the world's.
        variant: one of ``joints.VARIANTS``.
        grip: ``tool_midpoint``'s distance from the wrist-yaw axis, m.
    """
    base = Link(spec.worldbody.add_body(name="psm_base", pos=rcm), np.eye(4))
    _draw_base(base)
    yaw = _add_link(base, "yaw")
    _draw_yaw(yaw)
    closed = variant == "parallelogram"
    pitch = add_linkage(spec, yaw) if closed else _add_link(yaw, "pitch")
    _draw_carriage(pitch)
    if not closed:
        carry_linkage_inertia(yaw, pitch)
    insertion = _add_link(pitch, "insertion")
    _draw_instrument_housing(insertion)
    roll = _add_link(insertion, "roll")
    _draw_shaft(roll)
    wrist_pitch = _add_link(roll, "wrist_pitch")
    _draw_clevis(wrist_pitch)
    wrist_yaw = _add_link(wrist_pitch, "wrist_yaw")
    wrist_yaw.body.add_site(name="tool_midpoint", pos=[0, grip, 0], size=[0.001] * 3)
    wrist_yaw.body.add_site(name="tool", quat=psm.quaternion(psm.TOOL_OFFSET), size=[0.001] * 3)
    _add_jaws(spec, wrist_yaw)
    _add_servos(spec, closed)


def _add_link(parent: Link, name: str) -> Link:
    joint = psm.JOINTS[psm.JOINT_NAMES.index(name)]
    pose = psm.dh_transform(joint)
    body = parent.body.add_body(
        name=name, pos=pose[:3, 3], quat=psm.quaternion(pose[:3, :3]), gravcomp=1.0
    )
    add_joint(body, joint)
    return Link(body, parent.home @ pose)


def _draw_base(base: Link) -> None:
    base.rod([0, 0.62, 0], [0, 0.74, 0], 0.062, "arm_dark", kind="cylinder")
    base.box([0, 0.79, 0.02], [0.17, 0.12, 0.24], "arm_light")
    base.box([0, 0.79, -0.15], [0.11, 0.09, 0.10], "arm_dark")


def _draw_yaw(yaw: Link) -> None:
    back = pivots()["back"][1]
    yaw.rod([0, 0.47, 0], [0, 0.62, 0], 0.050, "arm_light", kind="cylinder", mass=MASS["yaw"])
    yaw.rod([-0.066, back, 0], [0.066, back, 0], 0.028, "arm_dark", kind="cylinder")


def _draw_carriage(pitch: Link) -> None:
    """The insertion rail behind the instrument, and the arms that hold it."""
    places = pivots()
    rail = {"mass": MASS["end"]}
    pitch.box([0, 0.046, 0.245], [0.044, 0.030, 0.35], "arm_light", **rail)
    pitch.box([0, 0.028, 0.245], [0.020, 0.008, 0.33], "arm_dark")
    pitch.rod(places["end_low"], [0, 0.046, 0.144], 0.014, "arm_dark")
    pitch.rod(places["end_high"], [0, 0.052, 0.236], 0.014, "arm_dark")
    # Cannula mount, and the cannula that ends just above the RCM.
    pitch.box([0, 0.026, 0.082], [0.026, 0.052, 0.014], "arm_dark")
    pitch.rod([0, 0, 0.032], [0, 0, 0.092], 0.0062, "steel", kind="cylinder")


def _draw_instrument_housing(insertion: Link) -> None:
    """The sterile adapter that slides on the rail, with the instrument's back end."""
    top = _SHAFT_TOP
    insertion.box(
        [0, 0.022, top + 0.012], [0.052, 0.012, 0.074], "arm_dark", mass=MASS["insertion"]
    )
    insertion.box([0, -0.006, top + 0.014], [0.046, 0.044, 0.062], "instrument")
    for side in (-0.011, 0.011):
        for height in (0.0, 0.026):
            spot = [side, -0.028, top + 0.002 + height]
            insertion.rod(spot, [side, -0.032, spot[2]], 0.008, "steel", kind="cylinder")


def _draw_shaft(roll: Link) -> None:
    tip = psm.SHAFT_OFFSET
    roll.rod(
        [0, 0, tip + 0.003],
        [0, 0, _SHAFT_TOP],
        _SHAFT_RADIUS,
        "shaft",
        kind="cylinder",
        mass=MASS["tool"] - 0.010,
    )
    # The wrist's two cheeks, and what a collision with the shaft feels.
    for side in (-1, 1):
        ear = [0.0026 * side, 0, tip]
        roll.box([ear[0], 0, tip + 0.0005], [0.0014, 0.0062, 0.0075], "steel")
    roll.rod([0, 0, tip + 0.002], [0, 0, 0.16], _SHAFT_RADIUS, "shaft", collides=True)


def _draw_clevis(wrist_pitch: Link) -> None:
    high, low = psm.SHAFT_OFFSET, psm.SHAFT_OFFSET - psm.WRIST_LENGTH
    wrist_pitch.rod([0, 0, high], [0, 0, low], 0.0026, "steel", mass=0.004)
    for side in (-1, 1):
        wrist_pitch.box(
            [0, 0.0030 * side, (high + low) / 2 - 0.002], [0.0056, 0.0012, 0.0095], "steel"
        )
    wrist_pitch.rod([0, 0, high], [0, 0, low], 0.0030, "steel", collides=True)


def _add_jaws(spec: mujoco.MjSpec, wrist_yaw: Link) -> None:
    """Two blades on the wrist-yaw axis, mirrored by a joint equality (the mimic pair)."""
    wrist_yaw.rod(
        wrist_yaw.home_of([0, 0, -0.0024]),
        wrist_yaw.home_of([0, 0, 0.0024]),
        0.0024,
        "steel",
        kind="cylinder",
        mass=0.003,
    )
    for index, side in ((1, 1.0), (2, -1.0)):
        # jaw_1 opens towards the tool frame's +y, which is the wrist-yaw frame's -x.
        _add_blade_mesh(spec, f"jaw_{index}", -side)
        body = wrist_yaw.body.add_body(name=f"jaw_{index}", gravcomp=1.0)
        body.add_joint(
            name=f"jaw_{index}",
            axis=Z_AXIS,
            range=sorted((side * psm.JAW_LOWER / 2, side * psm.JAW_UPPER / 2)),
            limited=True,
            armature=_JAW_ARMATURE,
        )
        body.add_geom(
            name=f"jaw_{index}_blade",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"jaw_{index}",
            material="jaw",
            mass=0.0015,
            **collision(False),
        )
        body.add_geom(
            name=f"jaw_{index}_pad",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[-side * 0.0007, psm.JAW_LENGTH / 2 + 0.0006, 0],
            size=[0.0007, psm.JAW_LENGTH / 2 - 0.0006, 0.0016],
            condim=6,
            friction=[1.2, 0.004, 0.0004],
            priority=1,
            solref=[0.004, 1.0],
            solimp=[0.95, 0.99, 0.0005, 0.5, 2.0],
            mass=0.0,
            **collision(True),
        )
    spec.add_equality(
        name="jaw_mimic",
        type=mujoco.mjtEq.mjEQ_JOINT,
        name1="jaw_2",
        name2="jaw_1",
        data=[0, -1, *[0] * 10],
        solref=[0.004, 1.0],
    )
    spec.add_exclude(name="jaws", bodyname1="jaw_1", bodyname2="jaw_2")
    for index in (1, 2):
        for link in ("wrist_pitch", "roll"):
            spec.add_exclude(name=f"jaw_{index}_{link}", bodyname1=f"jaw_{index}", bodyname2=link)
    tendon = spec.add_tendon(name="jaw")
    tendon.wrap_joint("jaw_1", 1.0)
    tendon.wrap_joint("jaw_2", -1.0)


def _add_blade_mesh(spec: mujoco.MjSpec, name: str, outward: float) -> None:
    """A blade that tapers from a round knuckle to a blunt tip, flat on its inner side."""
    stations = np.array([-0.0022, 0.0010, 0.0040, 0.0085, psm.JAW_LENGTH])
    depth = np.array([0.0016, 0.0024, 0.0022, 0.0016, 0.0010])
    width = np.array([0.0030, 0.0050, 0.0050, 0.0042, 0.0030]) / 2
    ring = []
    for y, thick, half in zip(stations, depth, width, strict=True):
        for x, z in (
            (0, -half),
            (0, half),
            (0.7, half),
            (1, half / 2),
            (1, -half / 2),
            (0.7, -half),
        ):
            ring.append([outward * x * thick, y, z])
    spec.add_mesh(
        name=name,
        uservert=np.array(ring).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
    )


def _add_servos(spec: mujoco.MjSpec, closed: bool) -> None:
    """Position servos, critically damped against the inertia each one moves."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    # Middle of the insertion range: where the task is done.
    data.joint("insertion").qpos = 0.15
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    for joint in psm.JOINTS:
        address = model.joint(joint.name).dofadr[0]
        inertia = mass[address, address]
        if closed and joint.name == "pitch":
            # The crank alone moves little; through the closures it turns the carriage.
            columns = {address: 1.0} | {
                model.joint(name).dofadr[0]: ratio for name, ratio in MIMIC.items()
            }
            index, weight = np.array(list(columns)), np.array(list(columns.values()))
            inertia = weight @ mass[np.ix_(index, index)] @ weight
        _add_servo(spec, joint.name, joint.name, inertia, joint, mujoco.mjtTrn.mjTRN_JOINT)
    jaw = psm.Joint("jaw", False, 0, 0, 0, 0, psm.JAW_LOWER, psm.JAW_UPPER, psm.JAW_EFFORT)
    _add_servo(spec, "jaw", "jaw", _JAW_ARMATURE, jaw, mujoco.mjtTrn.mjTRN_TENDON)


def _add_servo(spec, name, target, inertia, joint, transmission) -> None:
    bandwidth = _BANDWIDTH.get(name, _TOOL_BANDWIDTH)
    actuator = spec.add_actuator(
        name=name,
        target=target,
        trntype=transmission,
        ctrllimited=True,
        ctrlrange=[joint.lower, joint.upper],
        forcelimited=True,
        forcerange=[-joint.effort, joint.effort],
    )
    actuator.set_to_position(kp=inertia * bandwidth**2, kv=2 * inertia * bandwidth)
