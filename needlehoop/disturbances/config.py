"""Which axes there are, and how much of each a config asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from needlehoop.config.strict import Amount, Share
from needlehoop.disturbances import camera, delivery, picture, robot, scene
from needlehoop.disturbances.axis import Axis

GROUPS: dict[str, dict[str, Axis]] = {
    "camera": camera.AXES,
    "picture": {**picture.AXES, **delivery.AXES},
    "scene": scene.AXES,
    "robot": robot.AXES,
}
"""Axes by name, by what they disturb; in the order in which they act."""

AXES = {f"{group}.{name}": axis for group, own in GROUPS.items() for name, axis in own.items()}
"""All of them, by their keys under ``disturb``."""


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
        for group, valid in GROUPS.items():
            for name, amount in getattr(self, group).items():
                key = f"disturb.{group}.{name}"
                if name not in valid:
                    raise ValueError(f"{key}: unknown; choose from {', '.join(valid)}")
                if amount > valid[name].most:
                    raise ValueError(
                        f"{key}: {amount:g} must be at most {valid[name].most:g} {valid[name].unit}"
                    )
                if valid[name].whole and amount != int(amount):
                    raise ValueError(f"{key}: {amount:g} must be a whole number")

    @property
    def amounts(self) -> dict[str, float]:
        """The amounts of the axes that do something, by their keys in ``AXES``."""
        found = {
            f"{group}.{name}": amount
            for group in GROUPS
            for name, amount in getattr(self, group).items()
        }
        return {key: found[key] for key in AXES if found.get(key, 0.0) > 0}


def amount_at(
    levels: Mapping[str, Mapping[str, Sequence[float]]], key: str, severity: int
) -> float:
    """The amount of an axis at a severity of ``conf/levels``, which begin at 1; 0 is none."""
    group, _, name = key.partition(".")
    return levels[group][name][severity - 1] if severity else 0.0


def disturb_of(amounts: Mapping[str, float]) -> Disturb:
    """The config with these amounts, by their keys in ``AXES``."""
    split: dict[str, Any] = {group: {} for group in GROUPS}
    for key, amount in amounts.items():
        group, _, name = key.partition(".")
        split[group][name] = amount
    return Disturb(**split)
