"""Where a camera stands: not quite where it should.

Each function takes cameras, what was drawn for each view, and when; it gives the cameras as they
are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needlehoop.disturbances.axis import VIEW, Axis, Drawn, When


class Cameras(NamedTuple):
    """``position`` ``(n, views, 3)`` m, world frame; ``turn`` ``(n, views, 3, 3)``, the cameras'
    axes in columns; ``zoom`` ``(n, views)``, factor of the focal length."""

    position: np.ndarray
    turn: np.ndarray
    zoom: np.ndarray


def shift(cameras: Cameras, drawn: Drawn, when: When) -> Cameras:
    """Moved along the world's axes; the picture moves along."""
    return cameras._replace(position=cameras.position + drawn.amount)


def turn(cameras: Cameras, drawn: Drawn, when: When) -> Cameras:
    """Turned in place, about the camera's own axes."""
    return cameras._replace(turn=cameras.turn @ rotation(np.deg2rad(drawn.amount)))


def focal(cameras: Cameras, drawn: Drawn, when: When) -> Cameras:
    """Another focal length."""
    return cameras._replace(zoom=cameras.zoom * (1.0 + drawn.amount[..., 0]))


def drift(cameras: Cameras, drawn: Drawn, when: When) -> Cameras:
    """Moved more and more; by what was drawn when the time is up."""
    moved = when.share[:, None, None] * drawn.amount
    return cameras._replace(position=cameras.position + moved)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Matrices ``(…, 3, 3)`` of rotation vectors ``(…, 3)``, rad (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack((o, -z, y, z, o, -x, -y, x, o), -1).reshape(*vector.shape[:-1], 3, 3)
    half = np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.eye(3) + np.sinc(angle / np.pi) * cross + half * (cross @ cross)


AXES = {
    "shift": Axis("moved along each of the world's axes", "m", 0.1, shift, True, 3, per=VIEW),
    "turn": Axis("turned about each of its own axes", "degrees", 45.0, turn, True, 3, per=VIEW),
    "focal": Axis("another focal length", "share", 0.9, focal, True, per=VIEW),
    "drift": Axis("moves along each axis within an episode", "m", 0.1, drift, True, 3, per=VIEW),
}
