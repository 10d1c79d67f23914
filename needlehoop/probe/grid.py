"""A grid of cameras around the scene, probed like any others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from needlehoop.config.strict import Real
from needlehoop.scene.cameras import View


@dataclass(frozen=True)
class Grid:
    """Values in ``conf/probe.yaml``; angles in degrees, as in ``View``."""

    rendering: str
    like: str
    """View whose target, distance and depths the grid's cameras have."""
    fovy: float
    """Of the grid's cameras: wide enough for the scene from every side."""
    azimuths: tuple[Real, ...]
    elevations: tuple[Real, ...]

    def __post_init__(self) -> None:
        for key in ("azimuths", "elevations"):
            values = getattr(self, key)
            if len(values) < 2 or list(values) != sorted(set(values)):
                raise ValueError(f"grid.{key}: {list(values)} must be two or more, rising")

    def views(self, known: Mapping[str, View]) -> dict[str, View]:
        """The grid's views by name.

        Raises:
            ValueError: ``like`` is unknown, or an angle that no view can have.
        """
        if self.like not in known:
            raise ValueError(f"grid.like: {self.like!r} is unknown; choose from {', '.join(known)}")
        base = replace(known[self.like], fovy=self.fovy)
        return {
            name: replace(base, azimuth=azimuth, elevation=elevation)
            for (azimuth, elevation), name in self.names().items()
        }

    def names(self) -> dict[tuple[float, float], str]:
        """Names of the views by azimuth and elevation, such as ``az-30-el45``."""
        return {
            (azimuth, elevation): f"az{azimuth:g}-el{elevation:g}"
            for elevation in self.elevations
            for azimuth in self.azimuths
        }
