"""Axes of disturbance: their meanings, what an episode draws for each, and their config."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from needlehoop.config.strict import Amount, Share

EPISODE, VIEW, THING = "episode", "view", "thing"
"""An axis is drawn once an episode, for each view, or for each thing in the scene."""

GROUPS = ("camera", "picture", "scene", "robot")

MOST_OBJECTS = 12
"""Strange objects that may lie about."""


class Drawn(NamedTuple):
    """What episodes drew for an axis; a dimension for views or things follows ``n``."""

    amount: Tensor
    """``(n, …, size)`` float64, in the axis's unit."""
    free: Tensor
    """``(n, …, free)``: numbers in [0, 1) that decide where, when or which."""


@dataclass(frozen=True)
class Axis:
    """One kind of disturbance.

    An episode draws ``size`` numbers, uniform in [-amount, amount] if ``signed``, else in [0,
    amount]; the config gives the amount.
    """

    meaning: str
    unit: str
    most: float
    """Largest amount that makes sense."""
    signed: bool = False
    size: int = 1
    free: int = 0
    per: str = EPISODE
    whole: bool = False
    """Whether amounts are counts; an episode then draws one of 0, …, amount."""

    def drawn(self, numbers: Tensor, amounts: Tensor) -> Drawn:
        """What becomes of uniform numbers ``(n, …, size + free)`` at ``amounts`` ``(n,)``."""
        first, free = numbers[..., : self.size], numbers[..., self.size :]
        scale = amounts.reshape(-1, *[1] * (numbers.ndim - 1))
        if self.whole:
            return Drawn(torch.floor(first * (scale + 1.0)), free)
        return Drawn((2.0 * first - 1.0 if self.signed else first) * scale, free)


AXES = {
    # Where cameras stand.
    "camera.shift": Axis(
        "moved along the world's axes, on a body along its own", "m", 0.1, True, 3, per=VIEW
    ),
    "camera.turn": Axis("turned about each of its own axes", "degrees", 45.0, True, 3, per=VIEW),
    "camera.focal": Axis("another focal length", "share", 0.9, True, per=VIEW),
    "camera.drift": Axis("moves along each axis within an episode", "m", 0.1, True, 3, per=VIEW),
    # What they make of what they see, and when that arrives.
    "picture.blur": Axis("out of focus", "px", 3.0, per=VIEW),
    "picture.brightness": Axis("exposure", "share", 1.0, True, per=VIEW),
    "picture.contrast": Axis("contrast", "share", 1.0, True, per=VIEW),
    "picture.cast": Axis("white balance, by channel", "share", 1.0, True, 3, per=VIEW),
    "picture.noise": Axis("noise of colours", "grey levels", 255.0, per=VIEW),
    "picture.depth_noise": Axis("noise of depth", "m", 0.1, per=VIEW),
    "picture.depth_step": Axis("steps of depth", "m", 0.1, per=VIEW),
    "picture.labels": Axis("labels flipped along edges", "share", 1.0, per=VIEW),
    "picture.cover": Axis("blood on the lens", "share", 1.0, free=2, per=VIEW),
    "picture.late": Axis(
        "pictures are late, each view by itself", "steps", 20, per=VIEW, whole=True
    ),
    "picture.frozen": Axis("one view repeats a picture", "steps", 1000, free=2, whole=True),
    "picture.black": Axis("one view is black", "steps", 1000, free=2, whole=True),
    # What they look at.
    "scene.lamp": Axis("lamps hang elsewhere", "degrees", 90.0, True, 3),
    "scene.strength": Axis("strength of the lamps", "share", 1.0, True),
    "scene.colours": Axis("colour of each thing, by channel", "share", 1.0, True, 3, per=THING),
    "scene.sheen": Axis("highlights of each thing", "share", 1.0, per=THING),
    "scene.texture": Axis("pattern of the table", "share", 1.0, free=1),
    "scene.objects": Axis(
        "strange objects", "objects", MOST_OBJECTS, free=2 * MOST_OBJECTS, whole=True
    ),
    # What the robot does.
    "robot.offset": Axis("the tip is beside where it was told to", "m", 0.1, True, 3),
    "robot.late": Axis("commands are carried out late", "steps", 20, whole=True),
    "robot.lost": Axis("commands are lost", "share", 1.0),
    "robot.friction": Axis("friction of everything", "share", 0.99, True),
    "robot.mass": Axis("mass of what moves freely", "share", 0.99, True),
}
"""All of them, by their keys under ``disturb``; ``disturbance.py`` does what they say."""

RASTERISED = ("camera.focal", "scene.strength", "scene.colours", "scene.sheen", "scene.texture")
"""Those that the ray tracer cannot draw."""


@dataclass(frozen=True)
class Disturb:
    """Values in ``conf/disturb``: the amount of each axis; 0, or left out, is none."""

    camera: Mapping[str, Amount] = field(default_factory=dict)
    picture: Mapping[str, Amount] = field(default_factory=dict)
    scene: Mapping[str, Amount] = field(default_factory=dict)
    robot: Mapping[str, Amount] = field(default_factory=dict)
    ramp: Share = 0.0
    """Share of a training's steps over which amounts grow from none to full."""

    def __post_init__(self) -> None:
        for key, amount in self._by_key().items():
            if key not in AXES:
                group = key.partition(".")[0]
                valid = (name.removeprefix(f"{group}.") for name in AXES if name.startswith(group))
                raise ValueError(f"disturb.{key}: unknown; choose from {', '.join(valid)}")
            axis = AXES[key]
            if amount > axis.most:
                raise ValueError(
                    f"disturb.{key}: {amount:g} must be at most {axis.most:g} {axis.unit}"
                )
            if axis.whole and amount != int(amount):
                raise ValueError(f"disturb.{key}: {amount:g} must be a whole number")

    def _by_key(self) -> dict[str, float]:
        return {f"{g}.{name}": amount for g in GROUPS for name, amount in getattr(self, g).items()}

    @property
    def amounts(self) -> dict[str, float]:
        """The amounts of the axes that do something, by their keys in ``AXES``."""
        amounts = self._by_key()
        return {key: amounts[key] for key in AXES if amounts.get(key, 0.0) > 0}


def disturb_of(amounts: Mapping[str, float]) -> Disturb:
    """The config with these amounts, by their keys in ``AXES``."""
    split: dict[str, Any] = {group: {} for group in GROUPS}
    for key, amount in amounts.items():
        group, _, name = key.partition(".")
        split[group][name] = amount
    return Disturb(**split)


Levels = Mapping[str, Mapping[str, Sequence[float]]]
"""Amounts at severities 1, 2, … by axis, by group: ``conf/levels``."""


def ladder(levels: Levels, most: int = 0) -> dict[str, tuple[float, ...]]:
    """Amounts at severities 0 (none), 1, 2, … by axis.

    Raises ``ValueError`` unless every axis is there, with severities up to ``most``.
    """
    rows = {f"{g}.{name}": (0.0, *row) for g, axes in levels.items() for name, row in axes.items()}
    for key in rows.keys() ^ AXES.keys():
        raise ValueError(f"levels.{key}: {'missing' if key in AXES else 'no such axis'}")
    for key, row in rows.items():
        if len(row) <= most:
            raise ValueError(f"levels.{key}: give amounts at severities 1 to {most}")
    return rows


# The int64 with the same 64 bits, because torch has no arithmetic of unsigned ones.
_GOLDEN = 0x9E3779B97F4A7C15 - 2**64
_FIRST, _SECOND = 0xBF58476D1CE4E5B9 - 2**64, 0x94D049BB133111EB - 2**64


def uniform(name: str, count: int, *keys: Tensor | int) -> Tensor:
    """Numbers in [0, 1), float64 ``(n, count)``: the finaliser of SplitMix64 over name and keys.

    They depend on nothing else. So an episode is disturbed in the same way whatever runs beside
    it, and resuming needs no state. ``keys``: integers, or int64 ``(n,)`` of them, on any device.
    """
    device = next((key.device for key in keys if isinstance(key, Tensor)), None)
    state = torch.full((1,), zlib.crc32(name.encode()), device=device)
    for key in keys:
        state = _mixed(state ^ key)
    columns = (1 + torch.arange(count, device=device)) * _GOLDEN
    return _right(_mixed(state[:, None] + columns), 11).double() * 2.0**-53


def _mixed(state: Tensor) -> Tensor:
    state = state + _GOLDEN
    state = (state ^ _right(state, 30)) * _FIRST
    state = (state ^ _right(state, 27)) * _SECOND
    return state ^ _right(state, 31)


def _right(state: Tensor, bits: int) -> Tensor:
    """Bits shifted to the right, with zeros from the left."""
    return (state >> bits) & ((1 << (64 - bits)) - 1)
