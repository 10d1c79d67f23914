"""From an action to servo commands."""

from __future__ import annotations

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.scene.layout import Layout
from needlehoop.task.episode import Episode
from needlehoop.task.memory import State
from needlehoop.task.reach import pose_joints, tip_joints, tool_quat


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
        state.joints = tip_joints(layout, target, state.tool_roll)
    else:
        turn = geo.from_rotation_vector(episode.rotation * action[:, 3:6])
        wanted = geo.multiply(turn, state.quat)
        joints = pose_joints(layout, target, wanted, state.joints)
        # What the joints can do is the target: it never runs ahead of the limits. The
        # second pass brings the tip back from where an unreachable turn pulled it.
        state.quat = tool_quat(joints)
        state.joints = pose_joints(layout, target, state.quat, joints)
    state.target, state.jaw, state.steps = target, jaw, state.steps + 1
    return state, torch.cat((state.joints, jaw.unsqueeze(-1)), -1)


def _check_action(episode: Episode, state: State, action: Tensor) -> None:
    expected = (*state.batch_size, episode.action_size)
    if tuple(action.shape) != expected:
        raise ValueError(
            f"action: shape {tuple(action.shape)}; expected {expected}"
            f" for control={episode.control}"
        )
    if action.is_complex():
        raise ValueError(f"action: {str(action.dtype).rpartition('.')[2]}; expected real numbers")
    finite = torch.isfinite(action).all(-1)
    if not bool(finite.all()):
        bad = (~finite).nonzero().flatten().tolist()
        raise ValueError(f"action: not finite in environments {bad}; expected numbers in [-1, 1]")
