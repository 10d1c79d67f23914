"""Two PSMs side by side: each is the single arm, where it stands and under its name."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from needlehoop.envs.build import build, scene_spec
from needlehoop.envs.settings import compose_settings
from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.tasks.handover.scene import ARMS
from needlehoop.tasks.psm import ROBOT


def base(arm) -> tuple[np.ndarray, np.ndarray]:
    """Rotation ``(3, 3)`` and place ``(3,)`` of an arm's remote centre, by hand."""
    c, s = np.cos(arm.rcm_tilt), np.sin(arm.rcm_tilt)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array([arm.rcm_x, 0, arm.rcm_height])


@pytest.mark.parametrize("variant", psm.VARIANTS)
def test_each_arm_is_the_chain_from_where_it_stands(variant):
    settings = compose_settings(["task=handover", f"psm={variant}"])
    model = scene_spec(settings).compile()
    data = mujoco.MjData(model)
    lower, upper = psm.joint_limits()
    drawn = torch.rand(50, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    joints = lower + drawn * (upper - lower)
    places = psm.forward_kinematics(joints).numpy()
    qpos = np.tile(model.qpos0, (len(joints), 1))
    # The arms in different postures at the same time.
    for name, posture in zip(ARMS, (joints, joints.flip(0)), strict=True):
        psm.poser(model, f"{name}_")(qpos, posture.numpy(), np.zeros(len(posture)))
    for k, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        # The linkages are closed, and the jaws tied.
        tied = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert np.abs(data.efc_pos[tied]).max(initial=0.0) < 1e-9
        for name, pose in zip(ARMS, (places[k], places[-1 - k]), strict=True):
            turn, place = base(getattr(settings.task, name))
            site = data.site(f"{name}_tool")
            np.testing.assert_allclose(site.xpos, place + turn @ pose[:3, 3], atol=1e-9)
            np.testing.assert_allclose(
                site.xmat.reshape(3, 3), turn @ pose[:3, :3], rtol=0, atol=1e-9
            )


@pytest.mark.parametrize("moved", [0, 1])
def test_an_action_moves_its_arm_and_leaves_the_other(moved):
    simulation = build(compose_settings(["task=handover", "num_envs=1", "cams=[]"]))
    before = simulation.reset().signals
    action = torch.zeros(1, 10, dtype=torch.float64)
    action[0, 5 * moved : 5 * moved + 5] = torch.tensor([0.5, 1.0, 0.7, -1.0, -1.0])
    for _ in range(3):
        after = simulation.step(action).signals
    for _ in range(5):
        after = simulation.step(0.0 * action).signals
    for index, name in enumerate(ARMS):
        keys = (f"{name}_tool_midpoint", f"{name}_jaw", f"{name}_joints", f"{name}_jaw_command")
        tool, jaw, joints, command = (
            (getattr(after, key) - getattr(before, key)).squeeze(0) for key in keys
        )
        went = torch.tensor([0.009, 0.018, 0.0126]) if index == moved else torch.zeros(3)
        torch.testing.assert_close(tool, went.double(), rtol=0, atol=5e-4)
        assert float(command) == pytest.approx(-0.9 * (index == moved))
        assert float(jaw) == pytest.approx(-0.9 * (index == moved), abs=0.02)
        if index != moved:
            assert joints.abs().max() < 1e-3


def test_pose_control_turns_an_instrument_in_its_own_leaning_frame():
    words = ["task=handover", "num_envs=1", "cams=[]", "episode.control=pose"]
    simulation = build(compose_settings(words))
    before = simulation.reset().signals
    action = torch.zeros(1, 14, dtype=torch.float64)
    # PSM 2 about the x axis of its remote centre.
    action[0, 7 + 3] = 1.0
    for _ in range(2):
        simulation.step(action)
    for _ in range(6):
        after = simulation.step(0.0 * action).signals
    turns = {
        name: geo.multiply(
            getattr(after, f"{name}_tool_quat"), geo.conjugate(getattr(before, f"{name}_tool_quat"))
        )
        for name in ARMS
    }
    axis = base(simulation.layout.psm2)[0][:, 0]
    expected = np.concatenate(([np.cos(0.2)], np.sin(0.2) * axis))
    np.testing.assert_allclose(turns["psm2"][0].numpy(), expected, atol=2e-3)
    np.testing.assert_allclose(turns["psm1"][0].numpy(), [1, 0, 0, 0], atol=1e-6)


def test_signals_of_an_arm_are_the_single_arms_under_its_name():
    single = ROBOT.table({}, "needle")
    settings = compose_settings(["task=handover"])
    table = settings.definition.signals
    for name, word in ARMS.items():
        for key, row in single.items():
            signal = table[f"{name}_{key}"]
            assert (signal.shape, signal.unit, signal.frame) == (row.shape, row.unit, row.frame)
            assert signal.meaning == f"{word}: {row.meaning}"
            assert [one.objname for one in signal.sensors] == [
                f"{name}_{one.objname}" for one in row.sensors
            ]
    proprio = settings.definition.robot.proprio
    assert proprio == tuple(f"{name}_{key}" for name in ARMS for key in ROBOT.proprio)
