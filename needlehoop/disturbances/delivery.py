"""When a picture arrives: late, again and again, or not at all.

Each function takes what was drawn and when; what it gives is said below.
"""

from __future__ import annotations

import numpy as np

from needlehoop.disturbances.axis import VIEW, Axis, Drawn, When

_EARLY = 0.25
"""Share of an episode's time in which a camera may begin to fail."""


def late(drawn: Drawn, when: When) -> np.ndarray:
    """How many steps old each view's picture is ``(n, views)``."""
    return np.minimum(drawn.amount[..., 0].astype(int), when.steps[:, None])


def fails(drawn: Drawn, when: When, views: int, max_steps: int) -> np.ndarray:
    """Which view is failing now ``(n, views)`` bool: one of them, for so many steps."""
    begins = 1 + np.floor(drawn.free[:, 0] * _EARLY * max_steps)
    now = (when.steps >= begins) & (when.steps < begins + drawn.amount[:, 0])
    return now[:, None] & (np.floor(drawn.free[:, 1] * views)[:, None] == np.arange(views))


AXES = {
    "late": Axis("pictures are late, each view by itself", "steps", 20, late, per=VIEW, whole=True),
    "frozen": Axis("one view repeats a picture", "steps", 1000, fails, free=2, whole=True),
    "black": Axis("one view is black", "steps", 1000, fails, free=2, whole=True),
}
