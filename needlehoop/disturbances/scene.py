"""What the cameras look at: other light, other colours, other things lying about.

Each function takes the looks of the scene and what was drawn; it gives the looks as they are. No
physics changes.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from needlehoop.disturbances.axis import THING, Axis, Drawn
from needlehoop.disturbances.camera import rotation
from needlehoop.robot.shapes import collision

STRANGE = "strange_"
"""How names of strange objects begin."""

MOST_OBJECTS = 12

_NEAREST, _FURTHEST = 0.035, 0.085
"""Distances of strange objects from what the cameras look at, m."""

_HEIGHT = 0.004
"""Of their middles above the table, m."""

_CELLS = 500.0
"""Of the table's pattern to a m."""

HIDDEN = -1.0
"""Height of objects that are not there: under the table, m."""

_SIZES = (
    (mujoco.mjtGeom.mjGEOM_BOX, (0.006, 0.004, 0.003), (0.75, 0.25, 0.20)),
    (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.004, 0.006, 0.0), (0.85, 0.80, 0.30)),
    (mujoco.mjtGeom.mjGEOM_CAPSULE, (0.0025, 0.009, 0.0), (0.30, 0.45, 0.75)),
    (mujoco.mjtGeom.mjGEOM_BOX, (0.010, 0.0025, 0.0015), (0.70, 0.72, 0.76)),
)
"""Kinds of strange objects: shape, half sizes in m, RGB."""


class Looks(NamedTuple):
    """``lamps`` ``(n, lamps, 3)``: directions in which they shine, world frame. ``strength`` ``(n,
    1)``, ``tint`` ``(n, things, 3)``: factors. ``sheen`` ``(n, things)``. ``grain`` ``(n, 1, 3)``.
    See ``engines.contract.OPTICS``. ``objects`` ``(n, k, 3)``: where strange objects are, m.
    """

    lamps: np.ndarray
    strength: np.ndarray
    tint: np.ndarray
    sheen: np.ndarray
    grain: np.ndarray
    objects: np.ndarray


def lamp(looks: Looks, drawn: Drawn) -> Looks:
    """The lamps hang elsewhere: turned about the world's axes."""
    turned = rotation(np.deg2rad(drawn.amount))[:, None] @ looks.lamps[..., None]
    return looks._replace(lamps=turned[..., 0])


def strength(looks: Looks, drawn: Drawn) -> Looks:
    """The lamps are stronger or weaker; what lights everything stays."""
    return looks._replace(strength=looks.strength * (1.0 + drawn.amount))


def colours(looks: Looks, drawn: Drawn) -> Looks:
    """Each thing has another colour."""
    return looks._replace(tint=looks.tint * (1.0 + drawn.amount))


def sheen(looks: Looks, drawn: Drawn) -> Looks:
    """Each thing shines more or less."""
    return looks._replace(sheen=looks.sheen + drawn.amount[..., 0])


def texture(looks: Looks, drawn: Drawn) -> Looks:
    """The table has a pattern."""
    cells = np.full_like(drawn.free, _CELLS)
    begins = np.floor(drawn.free * 2.0**20)
    grain = np.stack((drawn.amount, begins, cells), -1)
    return looks._replace(grain=np.where(drawn.amount[..., None] > 0, grain, 0.0))


def objects(looks: Looks, drawn: Drawn) -> Looks:
    """So many strange objects lie about, around what the cameras look at."""
    count = looks.objects.shape[1]
    free = drawn.free.reshape(-1, MOST_OBJECTS, 2)[:, :count]
    angle, away = 2 * np.pi * free[..., 0], _NEAREST + (_FURTHEST - _NEAREST) * free[..., 1]
    there = np.arange(count) < drawn.amount
    x, y = away * np.cos(angle), away * np.sin(angle)
    places = looks.objects + np.stack((x, y, np.zeros_like(x)), -1)
    places[..., 2] = np.where(there, _HEIGHT, HIDDEN)
    return looks._replace(objects=places)


def add_objects(spec: mujoco.MjSpec, count: int) -> None:
    """Add strange objects to a scene, out of sight; they touch nothing."""
    for at in range(count):
        kind, size, rgb = _SIZES[at % len(_SIZES)]
        spec.worldbody.add_geom(
            name=f"{STRANGE}{at}",
            type=kind,
            size=size,
            pos=[0.0, 0.0, HIDDEN],
            quat=[np.cos(at), 0.0, 0.0, np.sin(at)],
            rgba=[*rgb, 1.0],
            **collision(False),
        )


AXES = {
    "lamp": Axis("lamps hang elsewhere", "degrees", 90.0, lamp, True, 3),
    "strength": Axis("strength of the lamps", "share", 1.0, strength, True),
    "colours": Axis("colour of each thing, by channel", "share", 1.0, colours, True, 3, per=THING),
    "sheen": Axis("highlights of each thing", "share", 1.0, sheen, per=THING),
    "texture": Axis("pattern of the table", "share", 1.0, texture, free=1),
    "objects": Axis(
        "strange objects", "objects", MOST_OBJECTS, objects, free=2 * MOST_OBJECTS, whole=True
    ),
}

RASTERISED = ("strength", "colours", "sheen", "texture")
"""Axes that the ray tracer cannot draw."""
