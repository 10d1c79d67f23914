from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from needlehoop.robot import psm
from needlehoop.tasks.needle_hoop.scene import NeedleLayout

# alpha, a, d, theta offset; limits, as published in the dVRK's PSM.json
# and LARGE_NEEDLE_DRIVER_400006.json.
PUBLISHED = {
    "yaw": ((90, 0.0, 0.0, 90), (-1.588, 1.588)),
    "pitch": ((-90, 0.0, 0.0, -90), (-0.925, 0.925)),
    "insertion": ((90, 0.0, -0.4318, 0), (0.0, 0.24)),
    "roll": ((0, 0.0, 0.4162, 0), (-4.538, 4.538)),
    "wrist_pitch": ((-90, 0.0, 0.0, -90), (-1.396, 1.396)),
    "wrist_yaw": ((-90, 0.0091, 0.0, -90), (-1.396, 1.396)),
}


def random_joints(count: int, seed: int = 0, share: float = 1.0) -> torch.Tensor:
    """Uniform joint vectors over the middle ``share`` of the limits."""
    lower, upper = psm.joint_limits()
    drawn = torch.rand(count, 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return (lower + upper) / 2 + share * (upper - lower) * (drawn - 0.5)


def turn_and_shift(axis: int, degrees: float, shift: float) -> np.ndarray:
    """A screw along a coordinate axis: the building block of a DH row."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    one, two = [(1, 2), (2, 0), (0, 1)][axis]
    pose = np.eye(4)
    pose[one, one], pose[one, two], pose[two, one], pose[two, two] = c, -s, s, c
    pose[axis, 3] = shift
    return pose


def published_pose(q: np.ndarray) -> np.ndarray:
    """The chain by hand: screws along x and z, row by row, and the fixed tip row's turn."""
    pose = np.eye(4)
    rows = zip(PUBLISHED.items(), q, strict=True)
    for (name, ((alpha, a, d, theta), _)), value in rows:
        slide, turn = (value, 0.0) if name == "insertion" else (0.0, np.rad2deg(value))
        pose = pose @ turn_and_shift(0, alpha, a) @ turn_and_shift(2, theta + turn, d + slide)
    return pose @ turn_and_shift(0, -90, 0.0) @ turn_and_shift(2, 90, 0.0)


def test_joints_have_the_published_limits():
    limits = {joint.name: (joint.lower, joint.upper) for joint in psm.JOINTS}
    assert limits == {name: published for name, (_, published) in PUBLISHED.items()}


def test_forward_kinematics_is_the_published_chain():
    q = random_joints(50)
    expected = np.stack([published_pose(row) for row in q.numpy()])
    np.testing.assert_allclose(psm.forward_kinematics(q).numpy(), expected, atol=1e-9)


def test_forward_kinematics_agrees_with_the_compiled_model(
    model: mujoco.MjModel, layout: NeedleLayout
):
    data = mujoco.MjData(model)
    q = random_joints(1000)
    poses = psm.forward_kinematics(q).numpy()
    qpos = np.tile(model.qpos0, (len(q), 1))
    psm.poser(model)(qpos, q.numpy(), np.zeros(len(q)))
    for row, pose in zip(qpos, poses, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        site = data.site("tool")
        np.testing.assert_allclose(site.xpos - layout.rcm, pose[:3, 3], atol=1e-6)
        np.testing.assert_allclose(site.xmat.reshape(3, 3), pose[:3, :3], atol=1e-6)


@pytest.mark.parametrize("leading", [(), (2, 3), (0,)])
def test_forward_kinematics_keeps_leading_dimensions_and_the_kind_of_array(leading):
    count = int(np.prod(leading))
    q = random_joints(count)
    poses = psm.forward_kinematics(q.reshape(*leading, 6))
    assert poses.shape == (*leading, 4, 4)
    assert poses.dtype == torch.float64
    arrays = psm.forward_kinematics(q.reshape(*leading, 6).numpy())
    np.testing.assert_array_equal(arrays, poses.numpy(), strict=True)
    for row, pose in zip(q, poses.reshape(-1, 4, 4), strict=True):
        torch.testing.assert_close(pose, psm.forward_kinematics(row), rtol=0, atol=1e-12)


def test_a_wrong_number_of_joints_names_them():
    with pytest.raises(ValueError, match="yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw"):
        psm.forward_kinematics(torch.zeros(5))


def test_straight_wrist_puts_the_point_on_target():
    generator = torch.Generator().manual_seed(1)
    drawn = torch.rand(200, 4, generator=generator, dtype=torch.float64)
    lower = torch.tensor([-0.08, -0.08, -0.22, -4.0], dtype=torch.float64)
    upper = torch.tensor([0.08, 0.08, -0.08, 4.0], dtype=torch.float64)
    target, roll = (lower + drawn * (upper - lower)).split([3, 1], -1)
    reach = 0.0088
    q = psm.straight_wrist(target, roll.squeeze(-1), reach)
    pose = psm.forward_kinematics(q)
    reached = pose[:, :3, 3] + reach * pose[:, :3, 2]
    torch.testing.assert_close(reached, target, rtol=0, atol=1e-9)
    torch.testing.assert_close(q[:, 3], roll.squeeze(-1), rtol=0, atol=0)
    assert bool((q[:, 4:] == 0).all())


def test_inverse_kinematics_finds_nearby_poses():
    q = random_joints(100, seed=2, share=0.8)
    # Near the remote centre the tip has no lever, and damping slows the last digits.
    q[:, 2] = q[:, 2].clamp(min=0.06)
    aside = random_joints(100, seed=3) - random_joints(100, seed=4)
    pose = psm.forward_kinematics(q)
    joints = psm.inverse_kinematics(pose, q + 0.02 * aside)
    torch.testing.assert_close(psm.forward_kinematics(joints), pose, rtol=0, atol=1e-6)


@pytest.mark.parametrize("place", [(0.0, 0.0, -1.0), (0.5, 0.5, 0.5)])
def test_inverse_kinematics_of_an_unreachable_pose_stays_within_limits(place):
    q = random_joints(20, seed=6)
    pose = psm.forward_kinematics(q)
    pose[:, :3, 3] = torch.tensor(place, dtype=torch.float64)
    joints = psm.inverse_kinematics(pose, q, iterations=30)
    lower, upper = psm.joint_limits()
    assert bool(torch.isfinite(joints).all())
    assert bool(((joints >= lower) & (joints <= upper)).all())
    assert bool(
        (psm.forward_kinematics(joints)[:, :3, 3] - pose[:, :3, 3]).norm(dim=-1).min() > 0.01
    )
