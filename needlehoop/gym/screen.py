"""What ``render`` gives: a picture of the scene, if a mode asks for it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from needlehoop.envs.simulation import Simulation
from needlehoop.pictures.stills import Photographer

MODES = ("human", "rgb_array")


def check_mode(mode: str | None, modes: Iterable[str], size: int) -> None:
    """Raises ``ValueError`` for a mode that is not among ``modes``, or a size below 1 px."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode: {mode!r} is unknown; choose from {', '.join(modes)}")
    if size < 1:
        raise ValueError(f"render_size: {size} must be at least 1")


class Picture:
    """Pictures of the scene from the place where those for people are taken.

    Args:
        simulation: what is pictured.
        size: height and width, px.
    """

    def __init__(self, simulation: Simulation, size: int):
        self._engine = simulation.engine
        self._photographer = Photographer(self._engine.model, size)

    def __call__(self, env: int) -> np.ndarray:
        """One environment at this moment: ``(size, size, 3)`` uint8."""
        return self._photographer(self._engine.data(env))
