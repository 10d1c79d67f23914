"""Where cameras stand, how the scene is lit and coloured, what lies about. No physics changes."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from needlehoop.disturbances.axes import MOST_OBJECTS, Drawn
from needlehoop.scene.shapes import collision

STRANGE = "strange_"
"""How names of strange objects begin."""

_NEAREST, _FURTHEST = 0.035, 0.085
"""Distances of strange objects from what the cameras look at, m."""

_HEIGHT, _HIDDEN = 0.004, -1.0
"""Of their middles above the table, m; of those that are not there, under it."""

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
    position: np.ndarray,
    turn: np.ndarray,
    drawn: Mapping[str, Drawn],
    time: np.ndarray,
    mounted: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cameras, moved along the world's axes, or along their own on a body; turned about their own.

    Returns positions and axes, and factors of the focal lengths ``(n, views)``.

    Args:
        position: ``(n, views, 3)`` m, world frame.
        turn: the cameras' axes in columns, ``(n, views, 3, 3)``.
        time: share of the episode that is over ``(n,)``: a camera drifts all the way in it.
        mounted: which are on a body ``(views,)`` bool.
    """
    shift, drift = (drawn[f"camera.{name}"].amount for name in ("shift", "drift"))
    drift = time[:, None, None] * drift
    if mounted.any():
        own = np.where(mounted[:, None, None], turn, np.eye(3))
        shift, drift = ((own @ moved[..., None])[..., 0] for moved in (shift, drift))
    return (
        position + shift + drift,
        turn @ rotation(np.deg2rad(drawn["camera.turn"].amount)),
        1.0 + drawn["camera.focal"].amount[..., 0],
    )


def lamps(direction: np.ndarray, drawn: Mapping[str, Drawn]) -> np.ndarray:
    """Where lamps shine ``(n, lamps, 3)``, turned about the world's axes."""
    turn = rotation(np.deg2rad(drawn["scene.lamp"].amount))
    return (turn[:, None] @ direction[..., None])[..., 0]


def looks(drawn: Mapping[str, Drawn], things: np.ndarray) -> dict[str, np.ndarray]:
    """Colours and light, as ``OPTICS`` has them; ``things``: of each geom ``(ngeom,)``."""
    texture = drawn["scene.texture"]
    begins = np.floor(texture.free * 2.0**20)
    # 500 cells of the table's pattern to a m.
    grain = np.stack((texture.amount, begins, np.full_like(begins, 500.0)), -1)
    return {
        "geom_tint": (1.0 + drawn["scene.colours"].amount)[:, things],
        "geom_sheen": drawn["scene.sheen"].amount[:, things, 0],
        "lamp_strength": 1.0 + drawn["scene.strength"].amount,
        "table_grain": np.where(texture.amount[..., None] > 0, grain, 0.0),
    }


def objects(drawn: Drawn, count: int, target: np.ndarray) -> np.ndarray:
    """Where strange objects are ``(n, count, 3)``, m: as many as were drawn, about ``target``."""
    free = drawn.free.reshape(-1, MOST_OBJECTS, 2)[:, :count]
    angle, away = 2 * np.pi * free[..., 0], _NEAREST + (_FURTHEST - _NEAREST) * free[..., 1]
    height = np.where(np.arange(count) < drawn.amount, _HEIGHT, _HIDDEN)
    return np.stack(
        (target[0] + away * np.cos(angle), target[1] + away * np.sin(angle), height), -1
    )


def rotation(vector: np.ndarray) -> np.ndarray:
    """Matrices ``(…, 3, 3)`` of rotation vectors ``(…, 3)``, rad (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack((o, -z, y, z, o, -x, -y, x, o), -1).reshape(*vector.shape[:-1], 3, 3)
    half = np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half * (cross @ cross)
