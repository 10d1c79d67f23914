"""Vectors and quaternions (w, x, y, z), batched, written out by component.

Reductions and matrix products may round differently for another batch size. Sums of named
components do not, so one environment stays equal to its row in a batch.
"""

from __future__ import annotations

from functools import reduce

import torch
from torch import Tensor


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar product of ``(..., k)`` vectors."""
    return reduce(torch.add, (a * b).unbind(-1))


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Euclidean distance of ``(..., k)`` points."""
    d = a - b
    return torch.sqrt(dot(d, d))


def aside(vector: Tensor) -> Tensor:
    """Horizontal length of ``(..., 3)`` vectors."""
    x, y = vector[..., 0], vector[..., 1]
    return torch.sqrt(x * x + y * y)


def rotate(quat: Tensor, vector: Tensor) -> Tensor:
    """``vector`` ``(..., 3)`` turned by ``quat`` ``(..., 4)``."""
    w, axis = quat[..., :1], quat[..., 1:]
    twice = 2.0 * cross(axis, vector)
    return vector + w * twice + cross(axis, twice)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Vector product of ``(..., 3)`` vectors."""
    ax, ay, az = a.unbind(-1)
    bx, by, bz = b.unbind(-1)
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), -1)


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Product of quaternions ``(..., 4)``: the turn ``b``, then ``a``."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        -1,
    )


def conjugate(quat: Tensor) -> Tensor:
    """The inverse turn of unit quaternions ``(..., 4)``."""
    return torch.cat((quat[..., :1], -quat[..., 1:]), -1)


def angle(x: Tensor, y: Tensor) -> Tensor:
    """The angle of the planar vector (x, y), rad in (-pi, pi).

    By the half angle: torch.atan2's last bit depends on where in a batch an element is.
    """
    return 2.0 * torch.atan(y / (torch.sqrt(x * x + y * y) + x))


def about_z(angle: Tensor) -> Tensor:
    """Quaternions ``(..., 4)`` of turns about z by ``angle`` ``(...,)``, rad."""
    half, zero = angle / 2, torch.zeros_like(angle)
    return torch.stack((torch.cos(half), zero, zero, torch.sin(half)), -1)


def from_rotation_vector(vector: Tensor) -> Tensor:
    """Quaternions ``(..., 4)`` of rotation vectors ``(..., 3)``, rad."""
    angle = torch.sqrt(dot(vector, vector)).unsqueeze(-1)
    # sin(x/2)/x tends to 1/2; the floor keeps the quotient finite there.
    scale = torch.sin(angle / 2) / angle.clamp(min=1e-12)
    return torch.cat((torch.cos(angle / 2), scale * vector), -1)


def to_matrix(quat: Tensor) -> Tensor:
    """Rotation matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)``."""
    eye = torch.eye(3, dtype=quat.dtype, device=quat.device)
    columns = [rotate(quat, eye[i].expand(*quat.shape[:-1], 3)) for i in range(3)]
    return torch.stack(columns, -1)


def ramp(value: Tensor, none: float, all_: float) -> Tensor:
    """0 up to ``none``, 1 from ``all_`` on, a straight line between; either may be the larger."""
    return ((value - none) / (all_ - none)).clamp(0.0, 1.0)
