"""What a dataset says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from needlehoop.envs.settings import Settings


@dataclass(frozen=True)
class About:
    """What a dataset says of itself."""

    demonstrator: str
    settings: Settings
    provenance: Mapping[str, Any]
    """Commit, versions, machine, time."""

    @property
    def rate(self) -> float:
        """Steps per second of simulated time."""
        return 1.0 / (self.settings.task.timestep * self.settings.episode.substeps)
