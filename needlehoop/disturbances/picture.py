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

_BLOOD = (8.0, 8.0, 90.0)
"""Colour of what covers the lens, BGR."""

_GREY = 128.0
"""What contrast leaves as it is."""


class Picture(NamedTuple):
    """``colour`` ``(n, h, w, 3)`` BGR, 0 to 255, float32, still to be multiplied by ``gain`` and
    added to ``bias`` ``(n, 1, 1, 3)``; ``depth`` ``(n, h, w)`` m, 0 where there is no reading;
    ``geom`` ``(n, h, w)`` geom ids, -1 for nothing. ``None``: not seen, or nothing to be done."""

    colour: Tensor | None
    depth: Tensor | None
    geom: Tensor | None
    gain: Tensor | None = None
    bias: Tensor | None = None


class Grains(NamedTuple):
    """Noise of these pictures: functions from a shape to numbers ``(n, *shape)``, float32."""

    normal: Callable[[tuple[int, ...]], Tensor]
    uniform: Callable[[tuple[int, ...]], Tensor]


def developed(picture: Picture) -> Picture:
    """The same with gain and bias worked in."""
    colour, _, _, gain, bias = picture
    if colour is None or gain is None or bias is None:
        return picture
    return picture._replace(colour=torch.addcmul(bias, colour, gain), gain=None, bias=None)


def blur(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Out of focus: a Gaussian of so many pixels."""
    if picture.colour is None:
        return picture
    at = torch.arange(_REACH + 1).float()
    width = _column(drawn.amount).view(-1, 1).clamp(min=1e-3)
    weights = torch.exp(-0.5 * (at / width) ** 2)
    # Beyond three deviations there is nothing, whatever else is in the batch.
    weights = torch.where(at < 3.0 * width, weights, 0.0)
    weights = weights / (weights.sum(1, keepdim=True) * 2.0 - weights[:, :1])
    reach = int((weights > 0).sum(1).max()) - 1
    colour = picture.colour
    for dim in (2, 1):
        size = colour.shape[dim]
        # Edges are repeated.
        first, last = colour.narrow(dim, 0, 1), colour.narrow(dim, size - 1, 1)
        wide = torch.cat([first] * reach + [colour] + [last] * reach, dim)
        colour = colour * weights[:, 0].view(-1, 1, 1, 1)
        for k in range(1, reach + 1):
            pair = wide.narrow(dim, reach - k, size) + wide.narrow(dim, reach + k, size)
            colour.addcmul_(pair, weights[:, k].view(-1, 1, 1, 1))
    return picture._replace(colour=colour)


def brightness(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Exposed for too long or too short: all colours by one factor."""
    return _graded(picture, 1.0 + _column(drawn.amount), 0.0)


def contrast(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Colours further from grey, or nearer to it."""
    amount = _column(drawn.amount)
    return _graded(picture, 1.0 + amount, -_GREY * amount)


def cast(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """A wrong white balance: blue, green and red each by a factor."""
    return _graded(picture, 1.0 + _column(drawn.amount), 0.0)


def noise(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Noise of the sensor, of its own in each pixel and channel."""
    seen = developed(picture)
    if seen.colour is None:
        return picture
    grain = grains.normal(tuple(seen.colour.shape[1:]))
    return seen._replace(colour=torch.addcmul(seen.colour, _column(drawn.amount), grain))


def depth_noise(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Noise of the depth, where there is a reading."""
    if picture.depth is None:
        return picture
    amount = _column(drawn.amount)[..., 0]
    noisy = torch.addcmul(picture.depth, amount, grains.normal(tuple(picture.depth.shape[1:])))
    return picture._replace(depth=noisy.clamp_(min=1e-4) * (picture.depth > 0))


def depth_step(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """Depth in whole steps."""
    if picture.depth is None:
        return picture
    step = _column(drawn.amount)[..., 0].clamp(min=1e-6)
    return picture._replace(depth=torch.round(picture.depth / step) * step)


def labels(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """So many pixels take over a neighbour's label, which shows along edges alone."""
    if picture.geom is None:
        return picture
    half = _column(drawn.amount)[..., 0] / 2
    chosen = grains.uniform(tuple(picture.geom.shape[1:]))
    beside, above = picture.geom.roll(1, 2), picture.geom.roll(1, 1)
    # At the border there is none.
    beside[..., 0], above[:, 0] = picture.geom[..., 0], picture.geom[:, 0]
    geom = torch.where(chosen < half, beside, picture.geom)
    return picture._replace(geom=torch.where(chosen > 1.0 - half, above, geom))


def cover(picture: Picture, drawn: Drawn, grains: Grains) -> Picture:
    """A drop of blood on the lens covers a share of the picture; nothing is seen through it."""
    seen = developed(picture)
    if seen.colour is not None:
        height, width = seen.colour.shape[1:3]
    else:
        height, width = next(one.shape[1:] for one in seen[1:3] if one is not None)
    share, place = torch.from_numpy(drawn.amount).float(), torch.from_numpy(drawn.free).float()
    rows = (torch.arange(height) + 0.5).view(1, -1, 1) - height * place[:, :1, None]
    columns = (torch.arange(width) + 0.5).view(1, 1, -1) - width * place[:, 1:, None]
    covered = rows**2 + columns**2 < (share * height * width / np.pi).unsqueeze(-1)
    colour, depth, geom, *_ = seen
    if colour is not None:
        colour = torch.where(covered.unsqueeze(-1), torch.tensor(_BLOOD), colour)
    if depth is not None:
        depth = torch.where(covered, 0.0, depth)
    if geom is not None:
        geom = torch.where(covered, -1, geom)
    return Picture(colour, depth, geom)


def _graded(picture: Picture, gain: Tensor, bias: Tensor | float) -> Picture:
    """Colours times ``gain`` plus ``bias``, after what is to be done to them already."""
    if picture.colour is None:
        return picture
    before = torch.ones_like(gain) if picture.gain is None else picture.gain
    own = torch.zeros(()) if picture.bias is None else picture.bias
    return picture._replace(gain=before * gain, bias=own * gain + bias)


def _column(amount: np.ndarray) -> Tensor:
    """Amounts ``(n, channels)`` beside pictures ``(n, h, w, channels)``."""
    return torch.from_numpy(amount).float()[:, None, None]


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
