"""What a camera makes of what it sees.

Each function takes the pictures of one view, what was drawn for it, and noise; it gives the
pictures as they are. It touches the channels that it would touch in a real camera: an exposure
changes colours and neither depth nor labels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from needlehoop.disturbances.axis import VIEW, Axis, Drawn

_REACH = 3
"""Pixels to each side that a blurred pixel takes in."""

_BLOOD = (90.0, 8.0, 8.0)
"""Colour of what covers the lens, RGB."""

_GREY = 128.0
"""What contrast leaves as it is."""


class Picture(NamedTuple):
    """``colour`` ``(n, 3, h, w)`` RGB, 0 to 255, float32; ``depth`` ``(n, h, w)`` m, 0 where there
    is no reading; ``geom`` ``(n, h, w)`` geom ids, -1 for nothing. ``None``: not seen."""

    colour: Tensor | None
    depth: Tensor | None
    geom: Tensor | None


class Grains(NamedTuple):
    """Noise of these pictures: functions from a shape to numbers ``(n, *shape)``, float32."""

    normal: Callable[[tuple[int, ...]], Tensor]
    uniform: Callable[[tuple[int, ...]], Tensor]


def blur(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Out of focus: a Gaussian of so many pixels."""
    if picture.colour is None:
        return picture
    at = torch.arange(-_REACH, _REACH + 1)
    width = _column(drawn.amount[:, :1]).view(-1, 1).clamp(min=1e-3)
    weights = torch.exp(-0.5 * (at / width) ** 2)
    weights = weights / weights.sum(1, keepdim=True)
    colour = picture.colour
    for dim in (-1, -2):
        # Edges are repeated.
        room = (_REACH, _REACH, 0, 0) if dim == -1 else (0, 0, _REACH, _REACH)
        wide = torch.nn.functional.pad(colour, room, mode="replicate")
        size = colour.shape[dim]
        parts = (
            weights[:, k].view(-1, 1, 1, 1) * wide.narrow(dim, k, size) for k in range(len(at))
        )
        colour = sum(parts, torch.zeros_like(colour))
    return picture._replace(colour=colour)


def brightness(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Exposed for too long or too short: all colours by one factor."""
    return _coloured(picture, lambda colour: colour * (1.0 + _column(drawn.amount)))


def contrast(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Colours further from grey, or nearer to it."""
    return _coloured(
        picture, lambda colour: _GREY + (colour - _GREY) * (1.0 + _column(drawn.amount))
    )


def cast(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """A wrong white balance: red, green and blue each by a factor."""
    return _coloured(picture, lambda colour: colour * (1.0 + _column(drawn.amount)))


def noise(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Noise of the sensor, of its own in each pixel and channel."""
    return _coloured(
        picture,
        lambda colour: colour + _column(drawn.amount) * grains.normal(tuple(colour.shape[1:])),
    )


def depth_noise(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Noise of the depth, where there is a reading."""
    if picture.depth is None:
        return picture
    amount = _column(drawn.amount).squeeze(1)
    noisy = picture.depth + amount * grains.normal(tuple(picture.depth.shape[1:]))
    return picture._replace(depth=torch.where(picture.depth > 0, noisy.clamp(min=1e-4), 0.0))


def depth_step(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Depth in whole steps."""
    if picture.depth is None:
        return picture
    step = _column(drawn.amount).squeeze(1).clamp(min=1e-6)
    return picture._replace(depth=torch.round(picture.depth / step) * step)


def labels(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """So many pixels take over a neighbour's label, which shows along edges alone."""
    if picture.geom is None:
        return picture
    geom = picture.geom
    share = torch.from_numpy(drawn.amount[:, 0]).float().view(-1, 1, 1)
    chosen = grains.uniform(tuple(geom.shape[1:]))
    for side, (dim, by) in enumerate(((1, 1), (1, -1), (2, 1), (2, -1))):
        taken = (chosen >= share * side / 4) & (chosen < share * (side + 1) / 4)
        geom = torch.where(taken, picture.geom.roll(by, dim), geom)
    return picture._replace(geom=geom)


def cover(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """A drop of blood on the lens covers a share of the picture; nothing is seen through it."""
    height, width = next(one.shape[-2:] for one in picture if one is not None)
    share, place = torch.from_numpy(drawn.amount), torch.from_numpy(drawn.free)
    rows = (torch.arange(height) + 0.5).view(1, -1, 1) - height * place[:, :1, None]
    columns = (torch.arange(width) + 0.5).view(1, 1, -1) - width * place[:, 1:, None]
    covered = rows**2 + columns**2 < (share * height * width / np.pi).unsqueeze(-1)
    colour, depth, geom = picture
    if colour is not None:
        blood = torch.tensor(_BLOOD).view(3, 1, 1)
        colour = torch.where(covered.unsqueeze(1), blood, colour)
    if depth is not None:
        depth = torch.where(covered, 0.0, depth)
    if geom is not None:
        geom = torch.where(covered, -1, geom)
    return Picture(colour, depth, geom)


def _coloured(picture: Picture, change: Callable[[Tensor], Tensor]) -> Picture:
    return picture if picture.colour is None else picture._replace(colour=change(picture.colour))


def _column(amount: np.ndarray) -> Tensor:
    """Amounts ``(n, channels)`` beside pictures ``(n, channels, h, w)``."""
    return torch.from_numpy(amount).float()[..., None, None]


AXES = {
    "blur": Axis("out of focus", "px", 3.0, blur, per=VIEW),
    "brightness": Axis("exposure", "share", 1.0, brightness, True, per=VIEW),
    "contrast": Axis("contrast", "share", 1.0, contrast, True, per=VIEW),
    "cast": Axis("white balance, by channel", "share", 1.0, cast, True, 3, per=VIEW),
    "noise": Axis("noise of colours", "grey levels", 255.0, noise, per=VIEW),
    "depth_noise": Axis("noise of depth", "m", 0.1, depth_noise, per=VIEW),
    "depth_step": Axis("steps of depth", "m", 0.1, depth_step, per=VIEW),
    "labels": Axis("labels flipped along edges", "share", 1.0, labels, per=VIEW),
    "cover": Axis("blood on the lens", "share", 1.0, cover, free=2, per=VIEW),
}
