"""Images that are not square, from the word that is typed to every face of an environment."""

import gymnasium
import numpy as np
import pytest
import torch

import needlehoop
from needlehoop.config import strict
from needlehoop.envs.settings import compose_settings
from needlehoop.pictures.film import _frame
from needlehoop.pictures.stills import scaled
from needlehoop.scene.image_size import ImageSize, extent, scaled_to, sides

CAMS = ("dep_front", "segdep_side")
WIDE = ["image_size=[48,32]", "engine.threads=1"]


@pytest.mark.parametrize(
    ("word", "size", "text"),
    [
        ("64", 64, "64"),
        ("[80,64]", (80, 64), "80 by 64"),
        ("[64,64]", 64, "64"),
        ("[1,3]", (1, 3), "1 by 3"),
    ],
)
def test_a_size_is_a_side_or_width_and_height(word, size, text):
    parsed = compose_settings([f"image_size={word}"]).image_size
    assert parsed == size
    assert extent(parsed) == text
    assert strict.structure(parsed, ImageSize) == size


@pytest.mark.parametrize("size", [64, (80, 64), (64, 80), (160, 90), (2048, 2), (2, 2048)])
@pytest.mark.parametrize("longer", [16, 33, 256])
def test_a_scaled_size_has_the_same_shape_and_is_one_that_may_be_typed(size, longer):
    scaled = scaled_to(size, longer)
    assert strict.structure(scaled, ImageSize) == scaled
    (w, h), (width, height) = sides(size), sides(scaled)
    assert max(width, height) == longer
    assert (width >= height) == (w >= h)
    assert min(width, height) == pytest.approx(longer * min(w, h) / max(w, h), abs=2.0)


def test_every_face_of_an_environment_has_the_images_that_it_says():
    env = needlehoop.make_env(cams=CAMS, num_envs=2, overrides=[*WIDE, "obs.frame_stack=2"])
    pixels = env.reset()["pixels"]
    assert pixels["dep_front"].shape == (2, 8, 32, 48)
    assert env.observation_spec.is_in(env.reset())
    vector = gymnasium.make_vec("needlehoop/NeedleHoop-v0", num_envs=2, cams=CAMS, overrides=WIDE)
    observed, _ = vector.reset(seed=1)
    assert vector.observation_space.contains(observed)
    moment = needlehoop.load(cams=CAMS, overrides=WIDE)
    shown = moment.reset().observation["segdep_side"]
    assert shown.shape == moment.observation_spec()["segdep_side"].shape == (32, 48, 3)


def test_a_wide_image_stays_wide_in_pictures_for_people():
    settings = compose_settings([f"cams=[{','.join(CAMS)}]", *WIDE])
    image = np.zeros((4, 32, 48), np.uint8)
    assert scaled(image, settings.renderings["dep"], 96).size == (96, 64)
    images = {name: torch.full((1, 4, 32, 48), 255, dtype=torch.uint8) for name in settings.cams}
    images["segdep_side"] = images["segdep_side"][:, :3]
    tiles = _frame(settings, np.zeros((480, 480, 3), np.uint8), images)[:, 480:]
    filled = (tiles == 255).all(-1)
    # Two tiles of 160 px, each filled from above to two thirds, but for its camera's name.
    assert filled[:80].all()
    assert not filled[108:160].any()
    assert filled[160:240].all()
