"""How the PSM's jaws hold a thing: by a weld of the wrist with it, or by friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import mujoco
import torch
from torch import Tensor

from needlehoop.robot import geometry as geo
from needlehoop.robot import psm
from needlehoop.tasks.contract import Memory, Weld
from needlehoop.tasks.layout import ArmEpisode

Readings = Mapping[str, Tensor]

_WELD = "grasp"
"""Name of the weld."""


def add_weld(
    spec: mujoco.MjSpec, rules: ArmEpisode, body: str, **softness: Sequence[float]
) -> None:
    """Add the (inactive) weld of the wrist with a body, for ``episode.grasp=weld``.

    ``softness``: MuJoCo's ``solref`` and ``solimp`` of it.
    """
    if rules.grasp == "weld":
        spec.add_equality(
            name=_WELD,
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="wrist_yaw",
            name2=body,
            active=False,
            **softness,
        )


def hold(
    rules: ArmEpisode,
    memory: Memory,
    readings: Readings,
    points: Callable[[], Tensor],
    position: Tensor,
    quat: Tensor,
) -> tuple[Tensor, dict[str, Weld]]:
    """Whether a thing is held, ``(n,)`` bool, and what the weld has to become.

    Args:
        rules: the kind of grasp, and the jaw commands that begin and end it.
        memory: after the action; ``grasped`` says what was held before.
        readings: ``jaw_1_touch``, ``jaw_2_touch`` and the arm's.
        points: gives places inside the thing ``(n, k, 3)``, world frame, m; for friction alone.
        position: of the welded body ``(n, 3)``, m.
        quat: of it ``(n, 4)``.
    """
    one, two, jaw = readings["jaw_1_touch"], readings["jaw_2_touch"], memory["jaw"]
    caught = one & two & (jaw < rules.close_below)
    held = memory["grasped"] & (jaw < rules.release_above)
    if rules.grasp == "friction":
        # Where nothing but contacts holds it, jaws closed on top of a thing hold nothing.
        if bool(caught.any()):
            caught = caught & _between_jaws(readings, points())
        return held & (one | two) | caught, {}
    held = held | caught
    inverse = geo.conjugate(readings["wrist_quat"])
    place = geo.rotate(inverse, position - readings["wrist_pos"])
    pose = torch.cat((place, geo.multiply(inverse, quat)), -1)
    return held, {_WELD: Weld(held != memory["grasped"], held, pose)}


def _between_jaws(readings: Readings, points: Tensor) -> Tensor:
    """Whether any of the points is in the gap between the blades; ``(n,)`` bool."""
    away = points - readings["wrist_pos"].unsqueeze(1)
    x, y, z = geo.rotate(geo.conjugate(readings["tool_quat"]).unsqueeze(1), away).unbind(-1)
    half_gap = torch.sin(readings["jaw"] / 2).unsqueeze(-1) * psm.JAW_LENGTH
    inside = (x.abs() < psm.JAW_WIDTH / 2) & (y.abs() < half_gap) & (z < psm.JAW_LENGTH) & (z > 0)
    return inside.any(1)
