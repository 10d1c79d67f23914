"""The task: pick the needle up, lift it, pass it through the hoop.

Pure, batched torch functions over a config and explicit state; every engine runs these
and nothing else. Facts are geometry. What an agent is paid is decided in ``rewards``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from pytorch_kinematics import matrix_to_quaternion
from tensordict import TensorClass
from torch import Tensor

from needlehoop import geometry as geo
from needlehoop import psm
from needlehoop.crossing import centre_line, passes_through
from needlehoop.episode import Episode
from needlehoop.layout import Layout
from needlehoop.signals import Signals

DRAWS = 9
"""Uniform numbers that one reset consumes."""

_SUNK = 1.25e-6
"""How deep a needle at rest sinks into the table, m (measured). Laid exactly on the
surface, rounding decides which of its contacts exist, and the rest kick it."""


class Start(TensorClass):
    """Where things are when an episode begins.

    ``tool`` ``(n, 3)`` is ``tool_midpoint``; ``joints`` ``(n, 6)``, ``jaw`` ``(n,)``,
    ``needle`` ``(n, 7)`` (position, quaternion), ``hoop`` and ``lift`` ``(n, 3)``; m, rad,
    world frame.
    """

    tool: Tensor
    joints: Tensor
    jaw: Tensor
    needle: Tensor
    hoop: Tensor
    lift: Tensor


class State(TensorClass):
    """What the task remembers between steps.

    ``target`` ``(n, 3)`` for ``tool_midpoint``, m; ``tool_roll`` ``(n,)`` about the instrument,
    rad; ``quat`` ``(n, 4)`` of the tool frame (``control=pose``); ``joints`` ``(n, 6)`` and
    ``jaw`` ``(n,)`` as commanded; latched facts; ``steps`` ``(n,)`` taken.
    """

    target: Tensor
    tool_roll: Tensor
    quat: Tensor
    joints: Tensor
    jaw: Tensor
    grasped: Tensor
    lifted: Tensor
    has_grasped: Tensor
    has_touched: Tensor
    steps: Tensor


class Weld(NamedTuple):
    """What the grasp's weld has to become.

    ``changed`` and ``active`` ``(n,)`` bool; ``pose`` ``(n, 7)`` of the needle in the
    wrist-yaw frame (position in m, quaternion), of use where ``active``.
    """

    changed: Tensor
    active: Tensor
    pose: Tensor


def draws(seed: int, env: int, episode: int) -> np.ndarray:
    """The uniform numbers ``(DRAWS,)`` of one episode of one environment.

    Counter-based: they depend on nothing but the three arguments, so an episode is the
    same whatever else runs beside it.
    """
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(env, episode))
    return np.random.Generator(np.random.Philox(sequence)).random(DRAWS)


def start(layout: Layout, uniform: Tensor) -> Start:
    """Scatter needle, hoop and tool over the layout's ranges.

    Args:
        layout: nominal placement and ranges.
        uniform: numbers in [0, 1) ``(n, DRAWS)``, float64.
    """
    spread = 2.0 * uniform - 1.0

    def scatter(nominal: tuple[float, ...], half: tuple[float, ...], at: int) -> Tensor:
        columns = [
            c + h * spread[:, at + i] for i, (c, h) in enumerate(zip(nominal, half, strict=True))
        ]
        return torch.stack(columns, -1)

    needle_xy = scatter(layout.needle_position, layout.needle_position_range, 0)
    yaw = layout.needle_yaw + layout.needle_yaw_range * spread[:, 2]
    hoop = scatter(layout.hoop_position, layout.hoop_position_range, 3)
    tool = scatter(layout.tool_position, layout.tool_position_range, 6)
    height = torch.full_like(needle_xy[:, :1], layout.needle_thickness / 2 - _SUNK)
    roll = torch.full_like(yaw, layout.tool_roll)
    return Start(
        tool=tool,
        joints=_tip_joints(layout, tool, roll),
        jaw=torch.full_like(yaw, layout.tool_jaw),
        needle=torch.cat((needle_xy, height, geo.about_z(yaw)), -1),
        hoop=hoop,
        lift=torch.cat((needle_xy, hoop[:, 2:]), -1),
        batch_size=[len(uniform)],
    )


def begin(layout: Layout, episode: Episode, begun: Start) -> State:
    """The task's memory at the start of an episode: targets where the tool is."""
    n = len(begun.jaw)
    no = torch.zeros(n, dtype=torch.bool)
    return State(
        target=begun.tool.clone(),
        tool_roll=begun.joints[:, 3].clone(),
        quat=_tool_quat(begun.joints) if episode.control == "pose" else torch.zeros(n, 4),
        joints=begun.joints.clone(),
        jaw=begun.jaw.clone(),
        grasped=no,
        lifted=no.clone(),
        has_grasped=no.clone(),
        has_touched=no.clone(),
        steps=torch.zeros(n, dtype=torch.int64),
        batch_size=[n],
    )


def act(layout: Layout, episode: Episode, state: State, action: Tensor) -> tuple[State, Tensor]:
    """Move the targets by an action and turn them into servo commands.

    Args:
        layout: workspace and limits that clamp the target.
        episode: control mode and action scales.
        state: memory before the action.
        action: ``(n, action_size)``; values beyond [-1, 1] are clamped.

    Returns:
        The state with its targets moved, and the servos' commands ``(n, 7)``: the six
        joints (rad, m) and the jaw (rad).

    Raises:
        ValueError: wrong shape, or a value that is not finite.
    """
    _check_action(episode, state, action)
    action = action.to(torch.float64).clamp(-1.0, 1.0)
    lower = torch.tensor(layout.workspace_lower, dtype=torch.float64)
    upper = torch.tensor(layout.workspace_upper, dtype=torch.float64)
    target = (state.target + episode.translation * action[:, :3]).clamp(lower, upper)
    jaw = state.jaw + episode.jaw * action[:, -1]
    jaw = jaw.clamp(layout.jaw_closed, layout.jaw_open)
    state = state.clone(recurse=False)
    if episode.control == "tip":
        roll = state.tool_roll + episode.rotation * action[:, 3]
        state.tool_roll = roll.clamp(
            layout.tool_roll - layout.roll_range, layout.tool_roll + layout.roll_range
        )
        state.joints = _tip_joints(layout, target, state.tool_roll)
    else:
        turn = geo.from_rotation_vector(episode.rotation * action[:, 3:6])
        wanted = geo.multiply(turn, state.quat)
        joints = _pose_joints(layout, target, wanted, state.joints)
        # What the joints can do is the target: it never runs ahead of the limits. The
        # second pass brings the tip back from where an unreachable turn pulled it.
        state.quat = _tool_quat(joints)
        state.joints = _pose_joints(layout, target, state.quat, joints)
    state.target, state.jaw, state.steps = target, jaw, state.steps + 1
    return state, torch.cat((state.joints, jaw.unsqueeze(-1)), -1)


def observe(
    layout: Layout, episode: Episode, state: State, readings: dict[str, Tensor]
) -> tuple[State, Signals, Weld]:
    """Decide the facts from the scene's readings.

    Args:
        layout: sizes of needle and hoop.
        episode: thresholds.
        state: memory after the action.
        readings: named sensor readings, current (read after a forward).

    Returns:
        The updated state, the signals, and what the grasp's weld has to become.
    """
    r = readings
    curve = centre_line(layout, r["pickup_point"], r["needle_quat"])
    grasped = _grasped(episode, state, r, curve)
    near = geo.distance(r["pickup_point"], r["lift_position"]) < episode.lift_radius
    lifted = state.lifted | (grasped & near)
    touched = geo.distance(r["needle_tip"], r["goal"]) < episode.goal_radius
    passed = passes_through(layout, episode.thread_depth, curve, r["goal"], r["hoop_axis"])
    weld = Weld(grasped != state.grasped, grasped, _relative_pose(r))
    state = state.clone(recurse=False)
    state.grasped, state.lifted = grasped, lifted
    state.has_grasped = state.has_grasped | grasped
    state.has_touched = state.has_touched | touched
    fields: dict[str, Any] = {
        **r,
        "jaw_command": state.jaw,
        "elapsed": state.steps.double() / episode.max_steps,
        "grasped": grasped,
        "lifted": lifted,
        "touched": touched,
        "threaded": passed & grasped,
    }
    signals = Signals(**fields, batch_size=state.batch_size)
    return state, signals, weld


def is_terminated(episode: Episode, signals: Signals) -> Tensor:
    """Success ends an episode, unless the config lets it run on; ``(n,)`` bool."""
    return signals.threaded & episode.end_on_success


def is_truncated(episode: Episode, state: State, signals: Signals) -> Tensor:
    """The time is up and success did not end it; ``(n,)`` bool."""
    return (state.steps >= episode.max_steps) & ~is_terminated(episode, signals)


def _grasped(episode: Episode, state: State, readings: dict[str, Tensor], curve: Tensor) -> Tensor:
    one, two = readings["jaw_1_touch"], readings["jaw_2_touch"]
    caught = one & two & (state.jaw < episode.close_below)
    held = state.grasped & (state.jaw < episode.release_above)
    if episode.grasp == "friction":
        # Where nothing but contacts holds it, jaws closed on top of the needle hold nothing.
        if bool(caught.any()):
            caught = caught & _between_jaws(readings, curve)
        held = held & (one | two)
    return held | caught


def _between_jaws(readings: dict[str, Tensor], curve: Tensor) -> Tensor:
    """Whether the centre line runs through the gap between the blades; ``(n,)`` bool.

    Closed jaws resting on the needle touch it with both blades and hold nothing.
    """
    away = curve - readings["wrist_pos"].unsqueeze(1)
    x, y, z = geo.rotate(geo.conjugate(readings["tool_quat"]).unsqueeze(1), away).unbind(-1)
    half_gap = torch.sin(readings["jaw"] / 2).unsqueeze(-1) * psm.JAW_LENGTH
    inside = (x.abs() < psm.JAW_WIDTH / 2) & (y.abs() < half_gap) & (z < psm.JAW_LENGTH) & (z > 0)
    return inside.any(1)


def _relative_pose(readings: dict[str, Tensor]) -> Tensor:
    """The needle's pose in the wrist-yaw frame, ``(n, 7)``."""
    inverse = geo.conjugate(readings["wrist_quat"])
    position = geo.rotate(inverse, readings["pickup_point"] - readings["wrist_pos"])
    return torch.cat((position, geo.multiply(inverse, readings["needle_quat"])), -1)


def _tip_joints(layout: Layout, tool: Tensor, roll: Tensor) -> Tensor:
    joints = psm.straight_wrist(tool - torch.from_numpy(layout.rcm), roll, layout.grip)
    return joints.clamp(*psm.joint_limits())


def _pose_joints(layout: Layout, tool: Tensor, quat: Tensor, nearby: Tensor) -> Tensor:
    pose = torch.zeros(len(tool), 4, 4, dtype=torch.float64)
    pose[:, :3, :3] = geo.to_matrix(quat)
    pose[:, :3, 3] = tool - torch.from_numpy(layout.rcm) - layout.grip * pose[:, :3, 2]
    return psm.inverse_kinematics(pose, nearby, iterations=4)


def _tool_quat(joints: Tensor) -> Tensor:
    return matrix_to_quaternion(psm.forward_kinematics(joints)[:, :3, :3])


def _check_action(episode: Episode, state: State, action: Tensor) -> None:
    expected = (*state.batch_size, episode.action_size)
    if tuple(action.shape) != expected:
        raise ValueError(
            f"action: shape {tuple(action.shape)}; expected {expected}"
            f" for control={episode.control}"
        )
    finite = torch.isfinite(action).all(-1)
    if not bool(finite.all()):
        bad = (~finite).nonzero().flatten().tolist()
        raise ValueError(f"action: not finite in environments {bad}; expected numbers in [-1, 1]")
