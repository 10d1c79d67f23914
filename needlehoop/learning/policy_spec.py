"""What a policy sees and does, and its networks: all that is needed to build it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import torch

from needlehoop.config.strict import Range, shown
from needlehoop.envs.settings import ImageSize
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.networks import HeadConfig


@dataclass(frozen=True)
class PolicySpec:
    """A policy's inputs, outputs and networks; the file of a policy has it under ``senses``."""

    channels: Mapping[str, Annotated[int, Range(1, 1024)]]
    """Of each camera's image, stacked frames included; in the order in which they are read."""
    image_size: ImageSize
    vectors: Mapping[str, Annotated[int, Range(1, 100_000)]]
    """Length of each other observation, in the order in which they are read."""
    encoder: EncoderConfig
    network: HeadConfig
    control: str
    """How its actions move the robot, see ``episode.control``."""
    actions: Annotated[int, Range(1, 1000)]
    """Length of the action."""
    precision: str

    def __post_init__(self) -> None:
        # They name modules of the networks.
        for name in (*self.channels, *self.vectors):
            if not name.isidentifier():
                raise ValueError(f"senses: {name!r} is no name of a camera or vector")

    @property
    def images(self) -> dict[str, torch.Size]:
        """The shape ``(c, h, w)`` of each camera's image."""
        size = self.image_size
        return {name: torch.Size((c, size, size)) for name, c in self.channels.items()}

    @property
    def keys(self) -> list[Any]:
        """What it reads of an environment, in order."""
        return [*(("pixels", name) for name in self.channels), *self.vectors]


def check_same(have: PolicySpec, want: PolicySpec, what: str) -> None:
    """Raises ``ValueError``, which begins with ``what``, for networks of something else."""
    for key in PolicySpec.__dataclass_fields__:
        own, other = getattr(have, key), getattr(want, key)
        if own != other:
            raise ValueError(
                f"{what}: the agent's networks were made for {key} {shown(own)}, and this is"
                f" {shown(other)}"
            )
