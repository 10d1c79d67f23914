"""Pictures for people."""

import numpy as np
import torch

from needlehoop.envs.settings import compose_settings
from needlehoop.pictures.film import _frame


def test_a_film_names_the_cameras_beside_the_scene():
    settings = compose_settings(["cams=[rgb_front,dep_side]"])
    dark = torch.zeros(1, 4, 64, 64, dtype=torch.uint8)
    frame = _frame(
        settings, np.zeros((480, 480, 3), np.uint8), {"rgb_front": dark[:, :3], "dep_side": dark}
    )
    tiles = frame[:, 480:]
    assert frame.shape == (480, 640, 3)
    for row in range(2):
        tile = tiles[160 * row : 160 * (row + 1)]
        # Letters at the lower left, and nowhere else.
        assert tile[130:, :80].max() == 255
        assert tile[:120].max() == 0
    assert tiles[320:].max() == 0
