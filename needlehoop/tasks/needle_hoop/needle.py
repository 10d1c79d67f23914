"""The suture needle: its shape, its body, and how it lies on the table."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.config.strict import Range
from needlehoop.robot import geometry as geo
from needlehoop.scene.shapes import add_mesh, collision, tube
from needlehoop.tasks.layout import Length, Place, Spread, Turn
from needlehoop.tasks.start import standing


@dataclass(frozen=True)
class Needle:
    """The needle and where it lies; see ``Layout``."""

    needle_radius: Length
    """Radius of the needle's arc, to its centre line."""
    needle_arc: Annotated[float, Range(1e-2, 6.0)]
    """Angle the arc spans."""
    needle_thickness: Length
    """Diameter of the needle's cross-section."""
    needle_mass: Annotated[float, Range(0.0, 10.0, above=True)]
    """kg."""
    needle_pickup: Annotated[float, Range(0.01, 0.99)]
    """Where the pickup point lies: fraction of the arc, measured from the tip."""
    needle_position: tuple[Place, Place]
    """Nominal pickup point on the table, x and y."""
    needle_yaw: Turn
    """Nominal heading: rotation about z of the needle's frame."""
    needle_position_range: tuple[Spread, Spread]
    needle_yaw_range: Spread

    @property
    def needle_angles(self) -> tuple[float, float]:
        """Arc angles of tail and tip; zero is the pickup point."""
        tip = self.needle_arc * self.needle_pickup
        return tip - self.needle_arc, tip

    def centre_line(self, angles: np.ndarray) -> np.ndarray:
        """Points ``(n, 3)`` of the needle's centre line, in the needle's frame.

        The frame sits at the pickup point: x towards the arc's centre, y along the
        needle towards the tip, z out of the arc's plane.
        """
        return self.needle_radius * np.stack(
            (1.0 - np.cos(angles), np.sin(angles), np.zeros_like(angles)), -1
        )


def add_needle(spec: mujoco.MjSpec, layout: Needle) -> mujoco.MjsBody:
    """A free body whose frame sits at the pickup point."""
    tail, tip = layout.needle_angles
    height = layout.needle_thickness / 2
    x, y = layout.needle_position
    half_yaw = layout.needle_yaw / 2
    body = spec.worldbody.add_body(
        name="needle", pos=[x, y, height], quat=[np.cos(half_yaw), 0, 0, np.sin(half_yaw)]
    )
    body.add_freejoint(name="needle")
    mesh = tube(layout.centre_line(np.linspace(tail, tip, 15)), height, taper=0.12)
    add_mesh(spec, body, "needle", mesh, "needle")
    segments = 7
    ends = layout.centre_line(np.linspace(tail, tip, segments + 1))
    add_chain(body, ends, height, 0.8, mass=layout.needle_mass / segments)
    return body


def add_chain(
    body: mujoco.MjsBody, points: np.ndarray, radius: float, friction: float, **mass: float
) -> None:
    """Capsules from point to point ``(k, 3)``, m, that are felt."""
    for index, (start, end) in enumerate(pairwise(points)):
        body.add_geom(
            name=f"{body.name}_{index}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=np.concatenate((start, end)),
            size=[radius, 0, 0],
            friction=[friction, 0.002, 0.0001],
            solref=[0.004, 1.0],
            **mass,
            **collision(True),
        )


def lying(layout: Needle, places: Tensor, yaw: Tensor) -> Tensor:
    """Poses ``(n, 7)`` of needles on the table: places ``(n, 2)``, m, and headings, rad."""
    # A needle at rest sinks so deep into the table (measured). Laid exactly on the surface,
    # rounding decides which of its contacts exist, and the rest kick it.
    return standing(places, layout.needle_thickness / 2 - 1.25e-6, yaw)


def centre_line(layout: Needle, position: Tensor, quat: Tensor) -> Tensor:
    """Points of the needle's centre line from tail to tip, ``(n, k, 3)`` in the world, m."""
    return position.unsqueeze(1) + geo.rotate(quat.unsqueeze(1), _local_curve(layout, quat.device))


@cache
def _local_curve(layout: Needle, device: torch.device) -> Tensor:
    tail, tip = layout.needle_angles
    return torch.from_numpy(layout.centre_line(np.linspace(tail, tip, 33))).to(device)
