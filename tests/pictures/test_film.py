"""Pictures for people."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from needlehoop.envs.settings import compose_settings
from needlehoop.pictures.film import _frame
from needlehoop.scene.cameras import in_rows


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


@pytest.mark.parametrize("cams", ["rgb_ecm_left,rgb_front,rgb_ecm_right", "stereo,rgb_front"])
def test_the_eyes_of_a_stereo_camera_are_side_by_side_in_a_film(cams):
    settings = compose_settings([f"cams=[{cams}]"])
    shades = {"rgb_ecm_left": 50, "rgb_ecm_right": 100, "rgb_front": 150}
    images = {
        name: torch.full((1, 3, 64, 64), shade, dtype=torch.uint8) for name, shade in shades.items()
    }
    frame = _frame(settings, np.zeros((480, 480, 3), np.uint8), images)
    assert frame.shape == (480, 800, 3)
    # In the upper part of each tile there are no letters.
    assert frame[50, [500, 600, 660, 760], 0].tolist() == [50, 50, 100, 100]
    assert frame[210, [500, 600, 660, 760], 0].tolist() == [150, 150, 0, 0]


def test_which_cameras_are_eyes():
    words = ["cams=[rgb_ecm_right,seg_ecm_left,rgb_ecm_left,seg_front,rgb_wrist]"]
    settings = compose_settings(words)

    def rows(**changes):
        views = {
            name: replace(view, **changes.get(name, {})) for name, view in settings.views.items()
        }
        return [[camera.name for camera in row] for row in in_rows(settings.cameras, views)]

    alone = [["rgb_ecm_right"], ["seg_ecm_left"], ["rgb_ecm_left"], ["seg_front"], ["rgb_wrist"]]
    pair = [["rgb_ecm_left", "rgb_ecm_right"], *alone[1:2], *alone[3:]]
    assert rows() == pair
    # Turned, zoomed, raised or on a body, one is no eye of the other's camera.
    for change in ({"roll": 1.0}, {"fovy": 40.0}, {"elevation": 46.0}, {"body": "roll"}):
        assert rows(ecm_left=change) == alone
    higher = (-0.00216, -0.017, 0.021)
    assert rows(ecm_left={"target": higher}) == alone
    far_left = (0.01, -0.017, 0.02)
    assert rows(ecm_left={"target": far_left}) == [["rgb_ecm_right", "rgb_ecm_left"], *pair[1:]]
