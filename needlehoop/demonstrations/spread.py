"""How values are spread, as LeRobot's policies want it to normalise by."""

from __future__ import annotations

from typing import Any

import numpy as np

_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def of_rows(values: np.ndarray) -> dict[str, Any]:
    """Over the rows of ``values`` ``(m,)`` or ``(m, k)``: lists of one or ``k`` numbers."""
    return _spread(values.reshape(len(values), -1).astype(np.float64), len(values), (-1,))


def of_images(images: np.ndarray) -> dict[str, Any]:
    """Over the pixels of ``images`` ``(m, h, w, c)`` uint8, 0 to 1: by channel, ``(c, 1, 1)``."""
    pixels = images.reshape(-1, images.shape[-1]) / 255.0
    return _spread(pixels, len(images), (-1, 1, 1))


def _spread(rows: np.ndarray, count: int, shape: tuple[int, ...]) -> dict[str, Any]:
    found = {
        "min": rows.min(0),
        "max": rows.max(0),
        "mean": rows.mean(0),
        "std": rows.std(0),
        **{name: np.quantile(rows, share, axis=0) for name, share in _QUANTILES.items()},
    }
    return {**{name: row.reshape(shape).tolist() for name, row in found.items()}, "count": [count]}
