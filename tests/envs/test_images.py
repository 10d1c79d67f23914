"""Views, renderings, and what must be seen in them."""

from itertools import product

import mujoco
import numpy as np
import pytest
import torch

from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
from needlehoop.scene.cameras import pose_of

ALL = [
    f"{r}_{v}" for r, v in product(("rgb", "dep", "seg", "segdep"), ("default", "front", "side"))
]


@pytest.fixture(scope="module")
def shown():
    settings = compose_settings([f"cams=[{','.join(ALL)}]", "num_envs=40", "seed=3"])
    simulation = build(settings)
    simulation.reset()
    return settings, simulation.images()


@pytest.mark.parametrize("difficulty", ["near", "standard", "wide"])
def test_the_needle_covers_twenty_pixels_at_the_start(difficulty):
    cams = ",".join(f"seg_{view}" for view in ("default", "front", "side", "ecm_left", "ecm_right"))
    settings = compose_settings([f"cams=[{cams}]", "num_envs=40", f"task={difficulty}"])
    simulation = build(settings)
    simulation.reset()
    needle = torch.tensor(settings.renderings["seg"].colours["needle"], dtype=torch.uint8)
    for name, image in simulation.images().items():
        assert (image == needle[:, None, None]).all(1).sum((1, 2)).min() >= 20, name


def test_a_depth_image_is_the_colour_image_with_one_more_channel(shown):
    _, images = shown
    assert torch.equal(images["dep_front"][:, :3], images["rgb_front"])
    depth = images["dep_front"][:, 3].float()
    assert depth.std() > 10
    # On the table, lower rows of the image are nearer, and nearer is brighter.
    assert (depth[:, -1, 2] > depth[:, -16, 2]).all()


def test_a_flat_image_holds_the_palette_and_black_only(shown):
    settings, images = shown
    palette = {(0, 0, 0), *map(tuple, settings.renderings["seg"].colours.values())}
    colours = images["seg_side"].permute(0, 2, 3, 1).reshape(-1, 3).unique(dim=0)
    assert {tuple(colour) for colour in colours.tolist()} == palette


def test_depth_shading_keeps_the_classes_and_darkens_what_is_far(shown):
    _, images = shown
    flat, shaded = images["seg_side"], images["segdep_side"]
    assert torch.equal(flat.amax(1) > 0, shaded.amax(1) > 0)
    assert (shaded <= flat).all()
    robot = flat[:, 2] == 255
    assert len(shaded[:, 2][robot].unique()) > 8


def test_views_stand_where_they_say():
    settings = compose_settings()
    place = {name: pose_of(view)[0] - view.target for name, view in settings.views.items()}
    front, side, default = place["front"], place["side"], place["default"]
    assert front[1] < 0
    assert abs(front[0]) < 1e-9
    # Half-way between front (-y) and left (-x).
    assert side[0] == pytest.approx(side[1])
    assert side[0] < 0
    # Half-way between front and top.
    assert default[2] == pytest.approx(-default[1])


def test_an_unknown_class_of_colours_is_refused():
    overrides = ["cams=[seg_front]", "+renderings.seg.colours.table=[1,2,3]"]
    with pytest.raises(ValueError, match=r"rendering\.colours: 'table' .*needle, hoop, robot"):
        build(compose_settings(overrides))


def test_the_tracer_sees_what_mujoco_casts_rays_at():
    # MuJoCo's own ray casting, pixel by pixel, as the oracle of camera model and shapes.
    cams = "cams=[segdep_default,segdep_front,segdep_side]"
    settings = compose_settings([cams, "num_envs=1", "engine.renderer=tracer", "image_size=32"])
    simulation = build(settings)
    simulation.reset()
    engine = simulation.engine
    frames, data, size = engine.render(), engine.data(0), settings.image_size
    at = (np.arange(size) + 0.5) / size * 2 - 1
    for name, view in settings.views.items():
        half = np.tan(np.deg2rad(view.fovy) / 2)
        x, y = np.meshgrid(at * half, -at * half)
        rays = np.stack((x, y, -np.ones_like(x)), -1).reshape(-1, 3)
        length = np.linalg.norm(rays, axis=1)
        position, turn = data.camera(name).xpos, data.camera(name).xmat.reshape(3, 3)
        hits = [cast(engine.model, data, position, turn @ ray) for ray in rays / length[:, None]]
        geom, reach = map(np.array, zip(*hits, strict=True))
        frame = frames[name]
        same = frame.geom[0].numpy().ravel() == geom
        assert same.mean() > 0.999, (name, same.mean())
        depth = frame.depth[0].numpy().ravel()
        both = same & (geom >= 0)
        assert np.abs(depth - reach / length)[both].max() < 1e-4, name


def cast(model, data, position, direction):
    """Geom and distance of a ray; mj_multiRay would lose half of the long shaft."""
    geom = np.zeros(1, np.int32)
    drawn = np.array([1, 1, 0, 0, 0, 0], np.uint8)
    distance = mujoco.mj_ray(model, data, position, direction, drawn, True, -1, geom, None)
    return int(geom[0]), distance
