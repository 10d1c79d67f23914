"""What a camera makes of what it sees.

Each function takes the flaws of the views' pictures and what was drawn for each view; it gives the
flaws as they are. The kernel then works them into the pixels, in the channels that they would touch
in a real camera: an exposure changes colours and neither depth nor labels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needlehoop.disturbances.axis import VIEW, Axis, Drawn

_GREY = 128.0
"""What contrast leaves as it is."""


class Flaws(NamedTuple):
    """What is wrong with pictures ``(n, views)``, in the order in which it acts.

    Colours: ``blur`` px, standard deviation of a Gaussian; then ``gain`` ``(n, views, 3)`` times
    them plus ``bias`` ``(n, views, 3)``, BGR, grey levels; ``noise`` grey levels, standard
    deviation, of its own in each pixel and channel. Depth, where there is a reading:
    ``depth_noise`` m, standard deviation; ``depth_step`` m, to whole multiples of it. Labels:
    ``flips``, share of the pixels that take over a neighbour's, which shows along edges alone.
    All of them: ``drop`` ``(n, views, 3)``, share of the picture that it covers, and its row and
    column as shares of the side.
    """

    blur: np.ndarray
    gain: np.ndarray
    bias: np.ndarray
    noise: np.ndarray
    depth_noise: np.ndarray
    depth_step: np.ndarray
    flips: np.ndarray
    drop: np.ndarray


def flawless(*shape: int) -> Flaws:
    """Nothing is wrong with pictures of this leading shape."""
    no, three = np.zeros(shape), np.zeros((*shape, 3))
    return Flaws(no, three + 1.0, three, no, no, no, no, three)


def blur(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Out of focus."""
    return flaws._replace(blur=drawn.amount[..., 0])


def brightness(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Exposed for too long or too short: all colours by one factor."""
    return _graded(flaws, 1.0 + drawn.amount, 0.0)


def contrast(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Colours further from grey, or nearer to it."""
    return _graded(flaws, 1.0 + drawn.amount, -_GREY * drawn.amount)


def cast(flaws: Flaws, drawn: Drawn) -> Flaws:
    """A wrong white balance: blue, green and red each by a factor."""
    return _graded(flaws, 1.0 + drawn.amount, 0.0)


def noise(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Noise of the sensor."""
    return flaws._replace(noise=drawn.amount[..., 0])


def depth_noise(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Noise of the depth."""
    return flaws._replace(depth_noise=drawn.amount[..., 0])


def depth_step(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Depth in whole steps."""
    return flaws._replace(depth_step=drawn.amount[..., 0])


def labels(flaws: Flaws, drawn: Drawn) -> Flaws:
    """Labels flipped along edges."""
    return flaws._replace(flips=drawn.amount[..., 0])


def cover(flaws: Flaws, drawn: Drawn) -> Flaws:
    """A drop of blood on the lens covers a share of the picture; nothing is seen through it."""
    return flaws._replace(drop=np.concatenate((drawn.amount, drawn.free), -1))


def _graded(flaws: Flaws, gain: np.ndarray, bias: np.ndarray | float) -> Flaws:
    """Colours times ``gain`` plus ``bias``, after what is done to them already."""
    return flaws._replace(gain=flaws.gain * gain, bias=flaws.bias * gain + bias)


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
