"""Where cameras stand, how the scene is lit and coloured, what lies about. No physics changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.disturbances.axes import MOST_OBJECTS, Drawn
from needlehoop.scene.shapes import collision

STRANGE = "strange_"
"""How names of strange objects begin."""

_NEAREST, _FURTHEST = 0.035, 0.085
"""Distances of strange objects from what the cameras look at, m."""

_HEIGHT, _HIDDEN = 0.004, -1.0
"""Height of an object's centre, m: if present, and if absent (hidden under the table)."""

_KINDS = (
    (mujoco.mjtGeom.mjGEOM_BOX, (0.006, 0.004, 0.003), (0.75, 0.25, 0.20)),
    (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.004, 0.006, 0.0), (0.85, 0.80, 0.30)),
    (mujoco.mjtGeom.mjGEOM_CAPSULE, (0.0025, 0.009, 0.0), (0.30, 0.45, 0.75)),
    (mujoco.mjtGeom.mjGEOM_BOX, (0.010, 0.0025, 0.0015), (0.70, 0.72, 0.76)),
)
"""Of strange objects: shape, half sizes in m, RGB."""


def add_objects(spec: mujoco.MjSpec, count: int) -> None:
    """Add strange objects to a scene, out of sight; they touch nothing."""
    for at in range(count):
        kind, size, rgb = _KINDS[at % len(_KINDS)]
        spec.worldbody.add_geom(
            name=f"{STRANGE}{at}",
            type=kind,
            size=size,
            pos=[0.0, 0.0, _HIDDEN],
            quat=[np.cos(at), 0.0, 0.0, np.sin(at)],
            rgba=[*rgb, 1.0],
            **collision(False),
        )


def cameras(
    position: Tensor, turn: Tensor, moved: Moved, time: Tensor, mounted: Tensor
) -> tuple[Tensor, Tensor]:
    """Cameras, moved along the world's axes, or along their own on a body; turned about their own.

    Returns positions and axes.

    Args:
        position: ``(n, views, 3)`` m, world frame.
        turn: the cameras' axes in columns, ``(n, views, 3, 3)``.
        time: share of the episode that is over ``(n,)``: a camera drifts all the way in it.
        mounted: which are on a body ``(views,)`` bool.
    """
    way = moved.shift + time[:, None, None] * moved.drift
    along = (turn.double() @ way[..., None])[..., 0]
    way = torch.where(mounted[:, None], along, way)
    return position + way, turn.double() @ moved.turn


class Moved(NamedTuple):
    """What episodes drew for where cameras stand ``(n, views, …)``, and for the lamps."""

    shift: Tensor
    """``(…, 3)``, m."""
    drift: Tensor
    """``(…, 3)``, m, until an episode's time is up."""
    turn: Tensor
    """Matrices ``(…, 3, 3)``."""
    zoom: Tensor
    """Factors of the focal lengths ``(…,)``."""
    lamp: Tensor
    """Matrices ``(n, 3, 3)``: the world's axes turned."""


def moved(drawn: Mapping[str, Drawn]) -> Moved:
    """What becomes of the numbers that were drawn."""
    return Moved(
        drawn["camera.shift"].amount,
        drawn["camera.drift"].amount,
        rotation(torch.deg2rad(drawn["camera.turn"].amount)),
        1.0 + drawn["camera.focal"].amount[..., 0],
        rotation(torch.deg2rad(drawn["scene.lamp"].amount)),
    )


def looks(drawn: Mapping[str, Drawn], things: Tensor) -> dict[str, Tensor]:
    """Colours and light, as ``OPTICS`` has them; ``things``: of each geom ``(ngeom,)``."""
    texture = drawn["scene.texture"]
    begins = torch.floor(texture.free * 2.0**20)
    # 500 cells of the table's pattern to a m.
    grain = torch.stack((texture.amount, begins, torch.full_like(begins, 500.0)), -1)
    return {
        "geom_tint": (1.0 + drawn["scene.colours"].amount)[:, things],
        "geom_sheen": drawn["scene.sheen"].amount[:, things, 0],
        "lamp_strength": 1.0 + drawn["scene.strength"].amount,
        "table_grain": torch.where(texture.amount[..., None] > 0, grain, 0.0),
    }


def objects(drawn: Drawn, count: int, target: np.ndarray) -> Tensor:
    """Where strange objects are ``(n, count, 3)``, m: as many as were drawn, about ``target``."""
    free = drawn.free.reshape(-1, MOST_OBJECTS, 2)[:, :count]
    angle, away = 2 * np.pi * free[..., 0], _NEAREST + (_FURTHEST - _NEAREST) * free[..., 1]
    height = torch.where(torch.arange(count) < drawn.amount, _HEIGHT, _HIDDEN)
    x, y = target[0] + away * torch.cos(angle), target[1] + away * torch.sin(angle)
    return torch.stack((x, y, height.double()), -1)


def rotation(vector: Tensor) -> Tensor:
    """Matrices ``(…, 3, 3)`` of rotation vectors ``(…, 3)``, rad (Rodrigues)."""
    x, y, z = vector.unbind(-1)
    angle = torch.sqrt(x * x + y * y + z * z)[..., None, None]
    o = torch.zeros_like(x)
    cross = torch.stack((o, -z, y, z, o, -x, -y, x, o), -1).unflatten(-1, (3, 3))
    half = torch.sinc(angle / (2 * np.pi)) ** 2 / 2
    eye = torch.eye(3, dtype=vector.dtype)
    return eye + torch.sinc(angle / np.pi) * cross + half * (cross @ cross)
