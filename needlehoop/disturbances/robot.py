"""What the robot does wrong.

Each function takes what was drawn; what it gives is said below.
"""

from __future__ import annotations

import numpy as np

from needlehoop.disturbances.axis import Axis, Drawn


def offset(drawn: Drawn) -> np.ndarray:
    """How far the tip stands from where it was told to, ``(n, 3)`` m, world frame."""
    return drawn.amount


def late(drawn: Drawn) -> np.ndarray:
    """How many steps late commands are carried out ``(n,)``."""
    return drawn.amount[:, 0].astype(int)


def lost(drawn: Drawn, chance: np.ndarray) -> np.ndarray:
    """Whether this step's command is lost ``(n,)``; ``chance`` ``(n,)`` is uniform in [0, 1)."""
    return chance < drawn.amount[:, 0]


def factor(drawn: Drawn) -> np.ndarray:
    """Factor of a physical quantity ``(n,)``."""
    return 1.0 + drawn.amount[:, 0]


AXES = {
    "offset": Axis("the tip is beside where it was told to", "m", 0.1, offset, True, 3),
    "late": Axis("commands are carried out late", "steps", 20, late, whole=True),
    "lost": Axis("commands are lost", "share", 1.0, lost),
    "friction": Axis("friction of everything", "share", 0.99, factor, True),
    "mass": Axis("mass of what moves freely", "share", 0.99, factor, True),
}
