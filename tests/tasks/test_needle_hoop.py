from __future__ import annotations

import math
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given
from needle_task import act, begin, observe, row, start
from torch import Tensor

from needlehoop.envs.settings import compose_settings
from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.tasks import stepping
from needlehoop.tasks.contract import Memory
from needlehoop.tasks.layout import GRASPS
from needlehoop.tasks.needle_hoop import TASK, facts
from needlehoop.tasks.needle_hoop.scene import NeedleLayout, NeedleRules
from needlehoop.tasks.start import NUMBERS, Start, draws

CONTROLS = NeedleRules.CONTROLS

TASKS = ("near", "standard", "wide")

HOOP = torch.tensor([[0.004, 0.025, 0.045]], dtype=torch.float64)
AXIS = torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)

# The tool frame in the needle's: z along -z, x along the needle, so y across it.
ACROSS_THE_NEEDLE = torch.tensor([[0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0]], dtype=torch.float64)


def needle_at(
    layout: NeedleLayout, offset, angle: float, heading: float = 0.0, *, lean: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Position ``(1, 3)`` and quaternion ``(1, 4)`` of a needle beside the hoop's centre.

    Its centre line has, at arc angle ``angle``, the position ``offset`` from the centre of
    the opening and the direction of the hoop's axis, turned by ``heading`` about z. The
    arc's plane is horizontal; ``lean`` turns it about the hoop's axis.
    """
    here, ahead = layout.centre_line(np.array([angle, angle + 1e-6]))
    along_x, along_y, _ = ahead - here
    upright = geo.about_z(row(math.atan2(along_x, along_y) + heading)[0])
    quat = geo.multiply(geo.from_rotation_vector(lean * AXIS), upright)
    return HOOP + row(*offset) - geo.rotate(quat, row(*here)), quat


def bend(layout: NeedleLayout) -> float:
    """1 where the needle, seen from above and followed to its tip, turns left; else -1."""
    one, two, three = layout.centre_line(np.array([-0.1, 0.0, 0.1]))
    return float(np.sign(np.cross(two - one, three - two)[2]))


def passes(layout: NeedleLayout, episode: NeedleRules, needle: tuple[Tensor, Tensor]) -> bool:
    curve = facts.centre_line(layout, *needle)
    return bool(facts.passes_through(layout, episode.thread_depth, curve, HOOP, AXIS))


def through(layout: NeedleLayout) -> tuple[Tensor, Tensor]:
    """A needle whose tip is 5 mm through the middle of the opening."""
    _, tip = layout.needle_angles
    return needle_at(layout, (0, 0, 0), tip - 0.3)


def seen(
    layout: NeedleLayout,
    needle: tuple[Tensor, Tensor],
    *,
    touch: tuple[bool, bool] = (True, True),
    gap: float = 0.4,
) -> dict[str, Tensor]:
    """Readings of a scene with the needle there and the jaws about its pickup point.

    ``gap`` is the angle between the jaws, rad.
    """
    position, quat = needle
    tool_quat = geo.multiply(quat, ACROSS_THE_NEEDLE)
    _, tip = layout.needle_angles
    point = torch.from_numpy(layout.centre_line(np.array([tip])))
    grip = row(0.0, 0.0, layout.grip)
    touch_1, touch_2 = torch.tensor(touch).split(1)
    return {
        "tool_midpoint": position.clone(),
        "tool_quat": tool_quat,
        "wrist_pos": position - geo.rotate(tool_quat, grip),
        "wrist_quat": geo.multiply(tool_quat, geo.from_rotation_vector(row(0.3, -0.2, 1.0))),
        "pickup_point": position,
        "needle_tip": position + geo.rotate(quat, point),
        "needle_quat": quat,
        "goal": HOOP.clone(),
        "hoop_axis": AXIS.clone(),
        "lift_position": HOOP - row(0.0, 0.06, 0.0),
        "joints": torch.zeros(1, 6, dtype=torch.float64),
        "jaw": torch.tensor([gap], dtype=torch.float64),
        "jaw_1_touch": touch_1,
        "jaw_2_touch": touch_2,
    }


def nominal_start(layout: NeedleLayout, count: int = 1) -> Start:
    return start(layout, torch.full((count, NUMBERS), 0.5, dtype=torch.float64))


def state_of(
    layout: NeedleLayout,
    episode: NeedleRules,
    *,
    jaw: float = 0.0,
    grasped: bool = False,
    lifted: bool = False,
    steps: int = 1,
) -> Memory:
    state = begin(episode, nominal_start(layout))
    state["jaw"] = torch.tensor([jaw], dtype=torch.float64)
    state["grasped"], state["lifted"] = torch.tensor([grasped]), torch.tensor([lifted])
    state["steps"] = torch.tensor([steps])
    return state


# Through the hoop, or not.


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0.6, -0.8)])
def test_the_centre_line_has_to_pass_inside_the_rim(layout, episode, direction):
    rim = layout.hoop_opening
    beside = 2 * layout.hoop_tube + layout.needle_thickness
    for into_the_rim in (5e-5, 1e-3, 3e-3, beside):
        assert not passes(layout, episode, off_centre(layout, direction, rim + into_the_rim))
    for inside in (5e-5, layout.needle_thickness / 2):
        assert passes(layout, episode, off_centre(layout, direction, rim - inside))


def off_centre(layout: NeedleLayout, direction, aside: float) -> tuple[Tensor, Tensor]:
    _, tip = layout.needle_angles
    x, z = direction
    return needle_at(layout, (x * aside, 0.0, z * aside), tip - 0.3)


@pytest.mark.parametrize("heading", [0.0, math.pi])
@pytest.mark.parametrize(("share", "expected"), [(0.5, False), (0.99, False), (1.01, True)])
def test_the_tip_has_to_be_thread_depth_beyond(layout, episode, share, expected, heading):
    _, tip = layout.needle_angles
    beyond = math.asin(share * episode.thread_depth / layout.needle_radius)
    needle = needle_at(layout, (0, 0, 0), tip - beyond, heading)
    assert passes(layout, episode, needle) == expected


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_tip_that_came_over_the_rim_only_touches(layout, episode, side):
    _, tip = layout.needle_angles
    # Around the hoop, and back towards the opening from the other side.
    heading = 2.0 * bend(layout) + (0.0 if side > 0 else math.pi)
    needle = needle_at(layout, (0.0, 0.003 * side, 0.0), tip, heading)
    along = side * (facts.centre_line(layout, *needle) - HOOP)[0, :, 1]
    assert along[-1] > episode.thread_depth
    assert along.min() < 0
    assert not passes(layout, episode, needle)
    _, signals, _ = observe_held(layout, episode, needle)
    assert bool(signals.touched)
    assert not bool(signals.threaded)


@pytest.mark.parametrize(("angle", "expected"), [(0.2, False), (1.2, True)])
def test_the_crossing_next_to_the_tip_decides(layout, episode, angle, expected):
    """A needle crosses the plane at two arc angles, and inside the rim at one of them."""
    heading = math.pi / 2 + bend(layout) * (angle - 0.7)
    assert passes(layout, episode, needle_at(layout, (0, 0, 0), angle, heading)) == expected


metres = st.floats(-0.3, 0.3)


@given(
    case=st.sampled_from(["through", "beside", "rim", "shallow", "tail"]),
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    shift=st.tuples(metres, metres, metres),
)
def test_the_verdict_depends_only_on_needle_relative_to_hoop(layout, episode, case, turn, shift):
    tail, tip = layout.needle_angles
    needle = {
        "through": through(layout),
        "beside": off_centre(layout, (1, 0), 0.02),
        "rim": off_centre(layout, (0, 1), layout.hoop_opening + layout.hoop_tube),
        "shallow": needle_at(layout, (0, 0, 0), tip - 0.05),
        "tail": needle_at(layout, (0, 0, 0), tail + 0.3, heading=math.pi),
    }[case]
    position, quat = needle
    turned = geo.from_rotation_vector(row(*turn))

    def move(point: Tensor) -> Tensor:
        return geo.rotate(turned, point) + row(*shift)

    curve = facts.centre_line(layout, move(position), geo.multiply(turned, quat))
    passed = facts.passes_through(
        layout, episode.thread_depth, curve, move(HOOP), geo.rotate(turned, AXIS)
    )
    assert bool(passed) == (case == "through")


# What observe makes of it.


def observe_held(layout, episode, needle):
    state = state_of(layout, episode, grasped=True)
    return observe(layout, episode, state, seen(layout, needle))


def test_a_needle_through_the_hoop_that_nobody_holds_is_not_threaded(layout, episode):
    state = state_of(layout, episode, jaw=layout.jaw_open)
    readings = seen(layout, through(layout), touch=(False, False), gap=1.0)
    _, signals, _ = observe(layout, episode, state, readings)
    assert not bool(signals.grasped)
    assert not bool(signals.threaded)


@pytest.mark.parametrize(("share", "expected"), [(0.98, True), (1.02, False)])
def test_touched_is_a_sphere_about_the_goal_and_is_remembered(layout, episode, share, expected):
    _, tip = layout.needle_angles
    reach = share * episode.goal_radius / math.sqrt(3)
    needle = needle_at(layout, (reach, -reach, reach), tip)
    state, signals, _ = observe_held(layout, episode, needle)
    assert bool(signals.touched) == bool(state["has_touched"]) == expected
    assert not bool(signals.threaded)
    away = seen(layout, needle_at(layout, (0, -0.05, 0), tip))
    state, signals, _ = observe(layout, episode, state, away)
    assert not bool(signals.touched)
    assert bool(state["has_touched"]) == expected


def grasp(layout: NeedleLayout, episode: NeedleRules, state: Memory, **scene) -> bool:
    readings = seen(layout, needle_at(layout, (0, -0.05, -0.02), 0.0), **scene)
    after, signals, weld = observe(layout, episode, state, readings)
    assert torch.equal(after["grasped"], signals.grasped)
    assert (weld is not None) == (episode.grasp == "weld")
    if weld is not None:
        assert torch.equal(weld.active, signals.grasped)
        assert torch.equal(weld.changed, after["grasped"] != state["grasped"])
    return bool(signals.grasped)


def test_a_grasp_needs_a_closing_command_and_both_jaws(layout, episode):
    assert grasp(layout, episode, state_of(layout, episode, jaw=0.99 * episode.close_below))
    assert not grasp(layout, episode, state_of(layout, episode, jaw=1.01 * episode.close_below))
    for touch in ((True, False), (False, True)):
        assert not grasp(layout, episode, state_of(layout, episode), touch=touch)


def test_a_grasp_needs_jaws_that_cannot_close_further(layout, episode):
    state = state_of(layout, episode, jaw=0.25)
    assert grasp(layout, episode, state, gap=0.3)
    assert not grasp(layout, episode, state, gap=0.2)


@pytest.mark.parametrize("kind", GRASPS)
def test_a_grasp_lasts_until_the_command_opens_beyond_release(layout, episode, kind):
    """Between the two thresholds what is held stays held, and what is not does not become it."""
    episode = replace(episode, grasp=kind)
    between = (episode.close_below + episode.release_above) / 2
    opened = 1.01 * episode.release_above
    assert grasp(layout, episode, state_of(layout, episode, jaw=between, grasped=True))
    assert not grasp(layout, episode, state_of(layout, episode, jaw=between, grasped=False))
    assert not grasp(layout, episode, state_of(layout, episode, jaw=opened, grasped=True))


@pytest.mark.parametrize(("kind", "expected"), [("weld", True), ("friction", False)])
def test_only_a_friction_grasp_ends_when_contact_is_lost(layout, episode, kind, expected):
    episode = replace(episode, grasp=kind)
    held = state_of(layout, episode, grasped=True)
    assert grasp(layout, episode, held, touch=(False, False), gap=0.0) == expected


def test_the_weld_keeps_the_needle_where_it_was_grasped(layout, episode):
    readings = seen(layout, needle_at(layout, (0, -0.05, -0.02), 0.3, heading=0.5, lean=0.4))
    _, _, weld = observe(layout, episode, state_of(layout, episode), readings)
    assert bool(weld.changed)
    assert bool(weld.active)
    wrist, position = readings["wrist_quat"], weld.pose[:, :3]
    placed = readings["wrist_pos"] + geo.rotate(wrist, position)
    torch.testing.assert_close(placed, readings["pickup_point"], rtol=0, atol=1e-12)
    turned = geo.multiply(wrist, weld.pose[:, 3:])
    assert float((turned * readings["needle_quat"]).sum().abs()) == pytest.approx(1.0)


def lift(layout: NeedleLayout, episode: NeedleRules, state: Memory, away: float, **scene) -> bool:
    """Whether the needle counts as lifted, with its pickup point so far from the lift position."""
    readings = seen(layout, needle_at(layout, (0, 0, 0), 0.0), **scene)
    readings["lift_position"] = readings["pickup_point"] + row(0.0, 0.0, away)
    after, signals, _ = observe(layout, episode, state, readings)
    assert torch.equal(after["lifted"], signals.lifted)
    return bool(signals.lifted)


def test_lifted_needs_a_grasp_at_the_lift_position_and_stays_true(layout, episode):
    held, free = state_of(layout, episode, grasped=True), state_of(layout, episode, jaw=0.9)
    near, far = 0.98 * episode.lift_radius, 1.02 * episode.lift_radius
    assert lift(layout, episode, held, near)
    assert not lift(layout, episode, held, far)
    assert not lift(layout, episode, free, near)
    dropped = state_of(layout, episode, jaw=0.9, lifted=True)
    assert lift(layout, episode, dropped, 0.5, touch=(False, False))


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("success", [False, True])
@pytest.mark.parametrize("ends", [False, True])
def test_success_terminates_and_only_time_truncates(layout, episode, late, success, ends):
    episode = replace(episode, end_on_success=ends)
    state = state_of(layout, episode, grasped=True, steps=episode.max_steps - (not late))
    needle = through(layout) if success else needle_at(layout, (0, -0.05, 0), 0.0)
    memory, _, facts, _ = stepping.observe(TASK, layout, episode, state, seen(layout, needle))
    facts["diverged"] = torch.tensor([False])
    terminated, truncated = stepping.ends(episode, memory, facts)
    assert bool(terminated) == (success and ends)
    assert bool(truncated) == (late and not terminated)


@pytest.mark.parametrize(("success", "at_goal"), [("thread", False), ("touch", True)])
def test_what_success_is_can_be_chosen(layout, episode, success, at_goal):
    """A tip at the goal, before the plane; and a needle that is through, its tip beyond."""
    episode = replace(episode, success=success, goal_radius=0.001)
    state = state_of(layout, episode, grasped=True)
    _, tip = layout.needle_angles
    through_, before = through(layout), needle_at(layout, (0.0, -0.0005, 0.0), tip)
    for needle, expected in ((before, at_goal), (through_, not at_goal)):
        memory, _, facts, _ = stepping.observe(TASK, layout, episode, state, seen(layout, needle))
        assert bool(facts["success"]) == expected
        terminated, _ = stepping.ends(episode, memory, {**facts, "diverged": torch.tensor([False])})
        assert bool(terminated) == expected


# Actions.


def tool_place(layout: NeedleLayout, joints: Tensor) -> Tensor:
    pose = psm.forward_kinematics(joints)
    return pose[:, :3, 3] + layout.grip * pose[:, :3, 2] + torch.from_numpy(layout.rcm)


def push(layout: NeedleLayout, episode: NeedleRules, state: Memory, action: Tensor, times: int):
    command = torch.empty(0)
    for _ in range(times):
        state, command = act(layout, episode, state, action)
    return state, command


def corners(size: int) -> Tensor:
    """Every action of -1s and 1s ``(2**size, size)``."""
    return torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * size)


def test_an_action_moves_the_tool_by_its_scale(layout, episode):
    state = begin(episode, nominal_start(layout))
    action = row(0.5, -1.0, 0.25, 1.0, -0.5)
    after, command = act(layout, episode, state, action)
    moved = tool_place(layout, command[:, :6]) - torch.tensor(layout.tool_position)
    expected = episode.translation * action[:, :3]
    torch.testing.assert_close(moved, expected, rtol=0, atol=1e-9)
    assert float(command[0, 3] - layout.tool_roll) == pytest.approx(episode.rotation)
    assert float(command[0, 6] - layout.tool_jaw) == pytest.approx(-0.5 * episode.jaw)
    assert after["steps"].tolist() == [1]


@pytest.mark.parametrize("control", CONTROLS)
def test_no_push_drives_the_target_out_of_the_workspace(layout, episode, control):
    episode = replace(episode, control=control)
    pushes = corners(3)
    state = begin(episode, nominal_start(layout, len(pushes)))
    action = torch.zeros(len(pushes), episode.action_size, dtype=torch.float64)
    action[:, :3] = pushes
    state, command = push(layout, episode, state, action, 30)
    lower, upper = torch.tensor([layout.workspace_lower, layout.workspace_upper]).double()
    torch.testing.assert_close(
        state["target"], torch.where(pushes > 0, upper, lower), rtol=0, atol=1e-6
    )
    torch.testing.assert_close(
        tool_place(layout, command[:, :6]), state["target"], rtol=0, atol=1e-6
    )
    # Nothing has wound up: the way back starts at once.
    back, _ = act(layout, episode, state, -action)
    torch.testing.assert_close(
        back["target"] - state["target"], -episode.translation * pushes, rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("control", CONTROLS)
def test_commands_stay_within_their_limits_and_values_beyond_one_act_as_one(
    layout, episode, control
):
    episode = replace(episode, control=control)
    pushes = corners(episode.action_size)
    state = begin(episode, nominal_start(layout, len(pushes)))
    assert torch.equal(
        act(layout, episode, state, 5 * pushes)[1], act(layout, episode, state, pushes)[1]
    )
    lower, upper = psm.joint_limits()
    for _ in range(20):
        state, command = act(layout, episode, state, pushes)
        assert command.shape == (len(pushes), 7)
        assert bool(((command[:, :6] >= lower) & (command[:, :6] <= upper)).all())
        assert bool((command[:, 6] >= layout.jaw_closed).all())
        assert bool((command[:, 6] <= layout.jaw_open).all())
        if control == "tip":
            turned = (command[:, 3] - layout.tool_roll).abs()
            assert float(turned.max()) <= layout.roll_range + 1e-9


def test_an_action_of_another_shape_or_not_finite_is_refused_by_name(layout, episode):
    state = begin(episode, nominal_start(layout, 4))
    with pytest.raises(ValueError, match=r"action: shape .*expected \(4, 5\) for control=tip"):
        act(layout, episode, state, torch.zeros(4, 6))
    action = torch.zeros(4, 5)
    action[1, 0], action[3, -1] = math.nan, -math.inf
    with pytest.raises(ValueError, match=r"action: not finite in environments \[1, 3\]"):
        act(layout, episode, state, action)


@pytest.mark.parametrize(("axis", "sense"), [(0, 1.0), (1, -1.0)])
def test_pose_control_turns_the_tool_about_the_worlds_axes(layout, episode, axis, sense):
    episode = replace(episode, control="pose")
    state = begin(episode, nominal_start(layout))
    action = torch.zeros(1, 7, dtype=torch.float64)
    action[0, 3 + axis] = sense
    after, command = act(layout, episode, state, action)
    turn = (
        psm.forward_kinematics(command[0, :6])[:3, :3]
        @ psm.forward_kinematics(state["joints"][0])[:3, :3].mT
    )
    expected = geo.to_matrix(geo.from_rotation_vector(episode.rotation * action[0, 3:6]))
    torch.testing.assert_close(turn, expected, rtol=0, atol=2e-3)
    torch.testing.assert_close(
        tool_place(layout, after["joints"]), state["target"], rtol=0, atol=1e-4
    )


def test_after_turning_without_end_the_way_back_begins_at_once(layout, episode):
    """The target does not run ahead of the joints' limits."""
    episode = replace(episode, control="pose")
    action = torch.zeros(6, 7, dtype=torch.float64)
    action[:, 3:6] = torch.cat((torch.eye(3), -torch.eye(3)))
    state, _ = push(layout, episode, begin(episode, nominal_start(layout, 6)), action, 200)
    lower, upper = psm.joint_limits()
    assert bool(((state["joints"] == lower) | (state["joints"] == upper)).any(-1).any())
    back, _ = push(layout, episode, state, -action, 3)
    moved = (back["joints"] - state["joints"]).abs().amax(-1)
    assert float(moved.min()) > episode.rotation
    away = tool_place(layout, state["joints"]) - torch.tensor(layout.tool_position)
    assert float(away.norm(dim=-1).max()) < 0.005


# Where episodes start.


def test_every_seed_environment_and_episode_draws_its_own_numbers():
    assert np.array_equal(draws(3, 5, 7), draws(3, 5, 7))
    keys = [(s, v, e) for s in range(4) for v in range(4) for e in range(4)]
    assert len({tuple(draws(*key)) for key in keys}) == len(keys)


def check_spread(values: Tensor, nominal, half) -> None:
    """All within the range, and near enough to both ends to have used it."""
    spread = (values - torch.tensor(nominal)) / torch.tensor(half)
    assert bool((spread.abs() <= 1 + 1e-9).all())
    assert bool((spread.amax(0) > 0.95).all())
    assert bool((spread.amin(0) < -0.95).all())


@pytest.mark.parametrize("name", TASKS)
def test_starts_fill_their_ranges_and_the_arm_reaches_them(name):
    layout = compose_settings([f"task={name}"]).task
    drawn = np.stack([draws(0, env, 0) for env in range(2000)])
    begun = start(layout, torch.from_numpy(drawn))
    check_spread(begun.free["needle"][:, :2], layout.needle_position, layout.needle_position_range)
    yaw = 2 * torch.atan2(begun.free["needle"][:, 6], begun.free["needle"][:, 3])
    check_spread(yaw, layout.needle_yaw, layout.needle_yaw_range)
    check_spread(begun.mocap["hoop"], layout.hoop_position, layout.hoop_position_range)
    check_spread(begun.robot["tool"], layout.tool_position, layout.tool_position_range)
    # At rest it is sunk by about a micrometre.
    assert bool(((begun.free["needle"][:, 2] - layout.needle_thickness / 2).abs() < 2e-6).all())
    assert bool((begun.free["needle"][:, 4:6] == 0).all())
    torch.testing.assert_close(
        tool_place(layout, begun.robot["joints"]), begun.robot["tool"], rtol=0, atol=1e-9
    )
    lower, upper = torch.tensor([layout.workspace_lower, layout.workspace_upper]).double()
    assert bool(((begun.robot["tool"] > lower) & (begun.robot["tool"] < upper)).all())
