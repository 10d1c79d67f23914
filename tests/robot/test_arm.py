from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from needle_task import act, begin, begun_data, spec_of, start

from needlehoop.envs.settings import Settings
from needlehoop.robot import psm
from needlehoop.tasks.needle_hoop.scene import NeedleLayout, NeedleRules, place
from needlehoop.tasks.psm import start_of
from needlehoop.tasks.start import NUMBERS, Start

MASSES = {
    "yaw": 1.47,
    "pitch_back": 0.985,
    "pitch_bottom": 0.446,
    "pitch_top": 0.178,
    "pitch_front": 0.074,
    "pitch": 2.09,
    "insertion": 0.225,
}
TOOL = ("roll", "wrist_pitch", "wrist_yaw", "jaw_1", "jaw_2")
RATIOS = {"pitch_bottom": -1.0, "pitch_end": 1.0, "pitch_top": -1.0, "pitch_front": 1.0}
"""Of the linkage's passive joints, per rad of pitch."""

BANDWIDTHS = {"yaw": 50.0, "pitch": 50.0, "insertion": 100.0}
"""Of the servos, rad/s; the others have 60."""

CENTRE = (0.0, -0.020, 0.035)
"""A place in mid-air, m, with 15 mm of free way on every side."""


@pytest.fixture(scope="module")
def variants(settings: Settings) -> dict[str, mujoco.MjModel]:
    """Both arms, in a scene where nothing collides."""
    models = {}
    for variant in psm.VARIANTS:
        spec = spec_of(settings, variant)
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        models[variant] = spec.compile()
    return models


def start_at(layout: NeedleLayout, where) -> Start:
    """The nominal start, with the tool elsewhere."""
    begun = start(layout, torch.full((1, NUMBERS), 0.5, dtype=torch.float64))
    tool = torch.tensor([list(where)], dtype=torch.float64)
    robot = start_of(layout, tool, begun.robot["joints"][:, 3], begun.robot["jaw"])
    return place(robot, begun.free["needle"], begun.mocap["hoop"])


def data_at(model: mujoco.MjModel, begun: Start) -> mujoco.MjData:
    data = begun_data(model, begun)
    mujoco.mj_forward(model, data)
    return data


def tool_tip(data: mujoco.MjData) -> np.ndarray:
    return data.site("tool_midpoint").xpos.copy()


def follow(
    model: mujoco.MjModel, layout: NeedleLayout, episode: NeedleRules, where, actions: torch.Tensor
):
    """The tool's path ``(steps, 3)``, one row a physics step, and the last target ``(3,)``."""
    begun = start_at(layout, where)
    data = data_at(model, begun)
    state = begin(episode, begun)
    path = []
    for action in actions:
        state, control = act(layout, episode, state, action[None])
        data.ctrl[:] = control[0].numpy()
        for _ in range(episode.substeps):
            mujoco.mj_step(model, data)
            path.append(tool_tip(data))
    return np.array(path), state["target"][0].numpy()


def closure_gap(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Largest distance, along an axis, between the pivots that a closure holds together, m."""
    kinds = model.eq_type[data.efc_id[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]]
    gaps = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    gaps = gaps[kinds == mujoco.mjtEq.mjEQ_CONNECT]
    assert gaps.size == 6
    return float(np.abs(gaps).max())


def test_bodies_have_the_published_masses(model: mujoco.MjModel):
    names = {model.body(i).name for i in range(model.nbody)}
    masses = {name: float(model.body(name).mass[0]) for name in MASSES if name in names}
    expected = {name: mass for name, mass in MASSES.items() if name in names}
    assert masses == pytest.approx(expected)
    assert sum(float(model.body(name).mass[0]) for name in TOOL) == pytest.approx(0.194)


def test_servos_are_critically_damped_for_what_they_move(variants):
    """The file has the results; the inertia is the model's, in the middle of the insertion."""
    for variant, model in variants.items():
        data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        data.joint("insertion").qpos = 0.15
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        for joint in psm.JOINTS:
            moved = {joint.name: 1.0}
            if variant == "parallelogram" and joint.name == "pitch":
                # The crank alone moves little; through the closures it turns the carriage.
                moved |= RATIOS
            at = [model.joint(name).dofadr[0] for name in moved]
            weight = np.array([*moved.values()])
            inertia = weight @ mass[np.ix_(at, at)] @ weight
            bandwidth = BANDWIDTHS.get(joint.name, 60.0)
            servo = model.actuator(joint.name)
            assert servo.gainprm[0] == pytest.approx(inertia * bandwidth**2, rel=1e-9)
            assert -servo.biasprm[2] == pytest.approx(2 * inertia * bandwidth, rel=1e-9)


@pytest.mark.parametrize(
    ("joint", "dry", "viscous"),
    [("yaw", 0.050, 0.0905), ("pitch", 0.0668, 0.218), ("insertion", 0.4476, 1.2036)],
)
def test_joints_have_the_identified_friction(model: mujoco.MjModel, joint, dry, viscous):
    assert model.joint(joint).frictionloss[0] == dry
    assert model.joint(joint).damping[0] == viscous


def test_jaws_mirror_each_other_under_a_one_sided_push(model: mujoco.MjModel, layout: NeedleLayout):
    data = data_at(model, start_at(layout, CENTRE))
    jaw_1, jaw_2 = data.joint("jaw_1"), data.joint("jaw_2")
    begun = float(jaw_1.qpos[0])
    pushed = model.joint("jaw_1").dofadr[0]
    for _ in range(100):
        # An eighth of what the jaw's motor can do.
        data.qfrc_applied[pushed] = 0.02
        mujoco.mj_step(model, data)
        assert jaw_1.qpos[0] == pytest.approx(-jaw_2.qpos[0], abs=1e-3)
    assert jaw_1.qpos[0] > begun + 0.01
    data.qfrc_applied[pushed] = 0.0
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert jaw_1.qpos[0] == pytest.approx(-jaw_2.qpos[0], abs=1e-5)
    assert jaw_1.qpos[0] == pytest.approx(begun, abs=1e-3)


def test_the_arm_holds_its_place(variants, layout: NeedleLayout):
    """Gravity is compensated, so a position servo alone does not sag."""
    for model in variants.values():
        data = data_at(model, start_at(layout, CENTRE))
        mujoco.mj_step(model, data, nstep=500)
        assert tool_tip(data) == pytest.approx(CENTRE, abs=1e-5)


def test_the_parallelogram_stays_closed_all_over_the_workspace(variants, layout: NeedleLayout):
    """Full-range jumps of the target are the worst a servo can do to the closures."""
    model = variants["parallelogram"]
    data = data_at(model, start_at(layout, CENTRE))
    generator = np.random.default_rng(0)
    misses = []
    for target in generator.uniform(layout.workspace_lower, layout.workspace_upper, (30, 3)):
        data.ctrl[:6] = start_at(layout, target).robot["joints"][0].numpy()
        for _ in range(round(0.4 / layout.timestep)):
            mujoco.mj_step(model, data)
            assert closure_gap(model, data) < 2e-4
        misses.append(np.linalg.norm(tool_tip(data) - target))
    # The longest jumps saturate the motors and still swing; most have arrived.
    assert np.median(misses) < 1e-4


@pytest.mark.parametrize(
    ("variant", "axis", "sense"),
    [(v, axis, (-1.0) ** (axis + i)) for i, v in enumerate(psm.VARIANTS) for axis in range(3)],
)
def test_the_tip_follows_a_full_speed_ramp_and_stops(
    variants, layout: NeedleLayout, episode: NeedleRules, variant, axis, sense
):
    place = np.array(CENTRE)
    place[axis] -= 2.5 * episode.translation * sense
    actions = torch.zeros(13, 5, dtype=torch.float64)
    actions[:5, axis] = sense
    path, target = follow(variants[variant], layout, episode, place, actions)
    assert target[axis] == pytest.approx(place[axis] + 5 * episode.translation * sense)
    beyond = sense * (path[:, axis] - target[axis])
    assert beyond.max() < 3e-4
    # At full speed the servo lags by less than an action.
    assert beyond[5 * episode.substeps - 1] > -episode.translation
    assert len(path) * layout.timestep == pytest.approx(0.2 + 0.32)
    assert np.linalg.norm(path[-1] - target) < 1e-4
