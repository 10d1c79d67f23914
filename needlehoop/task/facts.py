"""What is true of a moment: grasped, lifted, touched, threaded, and whether the episode is over.

Facts are geometry. What an agent is paid is decided in ``rewards``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.scene.layout import Layout
from needlehoop.scene.signals import Signals
from needlehoop.task.crossing import centre_line, passes_through
from needlehoop.task.episode import Episode
from needlehoop.task.memory import State


class Weld(NamedTuple):
    """What the grasp's weld has to become.

    ``changed`` and ``active`` ``(n,)`` bool; ``pose`` ``(n, 7)`` of the needle in the
    wrist-yaw frame (position in m, quaternion), of use where ``active``.
    """

    changed: Tensor
    active: Tensor
    pose: Tensor


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


def is_successful(episode: Episode, signals: Signals) -> Tensor:
    """Whether the task is done, as the config has it; ``(n,)`` bool."""
    return signals.touched if episode.success == "touch" else signals.threaded


def is_terminated(episode: Episode, signals: Signals) -> Tensor:
    """Success ends an episode, unless the config lets it run on; ``(n,)`` bool."""
    return is_successful(episode, signals) & episode.end_on_success


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
