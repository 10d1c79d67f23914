"""Each axis does what it says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from needlehoop.config import composing
from needlehoop.disturbances import camera, delivery, picture, scene
from needlehoop.disturbances.axis import Drawn, When
from needlehoop.disturbances.chance import Noise, uniform
from needlehoop.disturbances.config import AXES, GROUPS
from needlehoop.envs.settings import compose_settings

SIDE = 32


def drawn(*amount: float, free: tuple[float, ...] = ()) -> Drawn:
    return Drawn(np.array([amount], float), np.array([free], float))


@pytest.fixture
def grains() -> picture.Grains:
    noise, places = Noise(3 * SIDE * SIDE), np.array([0.3])
    return picture.Grains(
        lambda shape: noise.normal(places, shape), lambda shape: noise.uniform(places, shape)
    )


@pytest.fixture
def seen() -> picture.Picture:
    colour = torch.full((1, SIDE, SIDE, 3), 100.0)
    colour[:, :, SIDE // 2 :] = 160.0
    depth = torch.full((1, SIDE, SIDE), 0.4)
    depth[:, 0] = 0.0
    geom = torch.zeros(1, SIDE, SIDE, dtype=torch.int32)
    geom[..., SIDE // 2 :] = 5
    return picture.Picture(colour, depth, geom)


TOUCHES = {
    "blur": {"colour"},
    "brightness": {"colour"},
    "contrast": {"colour"},
    "cast": {"colour"},
    "noise": {"colour"},
    "depth_noise": {"depth"},
    "depth_step": {"depth"},
    "labels": {"geom"},
    "cover": {"colour", "depth", "geom"},
}


def test_all_axes_of_pictures_are_tried():
    assert set(TOUCHES) == set(picture.AXES)


@pytest.mark.parametrize("name", TOUCHES)
def test_an_axis_of_pictures_touches_what_it_would_in_a_real_camera(name, seen, grains):
    axis = picture.AXES[name]
    amount = {"blur": 1.0, "noise": 10.0, "depth_noise": 0.002, "depth_step": 0.03}.get(name, 0.3)
    some = drawn(*[amount] * axis.size, free=(0.5,) * axis.free)
    found = picture.developed(axis.apply(seen, some, grains))
    changed = {
        field
        for field in ("colour", "depth", "geom")
        if not torch.equal(getattr(found, field), getattr(seen, field))
    }
    assert changed == TOUCHES[name]


@pytest.mark.parametrize("name", TOUCHES)
def test_an_axis_of_pictures_takes_a_camera_without_its_channel(name, seen, grains):
    axis = picture.AXES[name]
    some = drawn(*[0.2] * axis.size, free=(0.5,) * axis.free)
    for field in ("colour", "depth", "geom"):
        alone = picture.Picture(None, None, None)._replace(**{field: getattr(seen, field)})
        found = picture.developed(axis.apply(alone, some, grains))
        assert [one is None for one in found] == [one is None for one in alone]


def test_depth_without_a_reading_stays_without_one(seen, grains):
    found = picture.depth_noise(seen, drawn(0.01), grains).depth
    assert bool((found[:, 0] == 0).all())
    assert float(found[:, 1:].std()) == pytest.approx(0.01, rel=0.15)


def test_labels_flip_along_edges_alone(seen, grains):
    found = picture.labels(seen, drawn(0.5), grains).geom
    flipped = (found != seen.geom)[0].nonzero()[:, 1].unique().tolist()
    assert flipped == [SIDE // 2]


def test_a_drop_covers_its_share(seen, grains):
    found = picture.cover(seen, drawn(0.1, free=(0.5, 0.5)), grains)
    assert float((found.geom == -1).float().mean()) == pytest.approx(0.1, abs=0.01)


def test_blur_keeps_the_mean_and_blends_the_edge(seen, grains):
    found = picture.blur(seen, drawn(1.0), grains).colour
    assert float(found.mean()) == pytest.approx(float(seen.colour.mean()), rel=1e-3)
    assert 100.0 < float(found[0, 5, SIDE // 2, 0]) < 160.0


def test_a_camera_is_shifted_turned_zoomed_and_drifts():
    start = camera.Cameras(np.zeros((1, 2, 3)), np.tile(np.eye(3), (1, 2, 1, 1)), np.ones((1, 2)))
    when = When(np.array([5]), np.array([0.5]))
    own = Drawn(np.array([[[0.01, 0.0, 0.0], [0.0, 0.02, 0.0]]]), np.zeros((1, 2, 0)))
    assert np.array_equal(camera.shift(start, own, when).position, own.amount)
    assert np.array_equal(camera.drift(start, own, when).position, own.amount / 2)
    quarter = Drawn(np.array([[[90.0, 0.0, 0.0], [0.0, 0.0, 0.0]]]), np.zeros((1, 2, 0)))
    turned = camera.turn(start, quarter, when).turn
    assert np.allclose(turned[0, 0] @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    assert np.array_equal(turned[0, 1], np.eye(3))
    wide = Drawn(np.array([[[0.1], [-0.1]]]), np.zeros((1, 2, 0)))
    assert np.allclose(camera.focal(start, wide, when).zoom, [[1.1, 0.9]])


def test_one_view_fails_and_the_late_one_is_late_alone():
    one = Drawn(np.array([[3.0]]), np.array([[0.0, 0.9]]))
    fails = [
        delivery.fails(one, When(np.array([step]), np.array([0.0])), 2, 100)[0].tolist()
        for step in range(6)
    ]
    assert fails == [[False, False], *[[False, True]] * 3, *[[False, False]] * 2]
    late = Drawn(np.array([[[0.0], [2.0]]]), np.zeros((1, 2, 0)))
    assert delivery.late(late, When(np.array([9]), np.zeros(1))).tolist() == [[0, 2]]
    assert delivery.late(late, When(np.array([1]), np.zeros(1))).tolist() == [[0, 1]]


def test_lamps_keep_their_length_when_they_hang_elsewhere():
    looks = scene.Looks(
        np.array([[[0.0, 0.0, -1.0]]]), np.ones((1, 1)), np.ones((1, 2, 3)), np.zeros((1, 2)),
        np.zeros((1, 1, 3)), np.zeros((1, 3, 3)),
    )  # fmt: skip
    found = scene.lamp(looks, drawn(20.0, -10.0, 5.0)).lamps
    assert np.allclose(np.linalg.norm(found, axis=-1), 1.0)
    assert found[0, 0, 2] > -0.99
    count = Drawn(np.array([[2.0]]), np.full((1, 2 * scene.MOST_OBJECTS), 0.4))
    assert (scene.objects(looks, count).objects[0, :, 2] > 0).tolist() == [True, True, False]


def test_numbers_depend_on_every_key_and_on_nothing_else():
    envs = np.arange(1000)
    some = uniform("a", 3, 7, envs, np.zeros(1000, int))
    assert np.array_equal(some[5:6], uniform("a", 3, 7, np.array([5]), np.array([0])))
    assert abs(some.mean() - 0.5) < 0.02
    assert abs(some.std() - 12**-0.5) < 0.01
    assert abs(np.corrcoef(some.T)[0, 1]) < 0.1
    for other in (("b", 3, 7, envs, 0), ("a", 3, 8, envs, 0), ("a", 3, 7, envs, 1)):
        assert not np.isclose(uniform(*other), some).any(1).all()
    assert len(np.unique(some)) == 3000


def test_whole_amounts_are_counts():
    axis = AXES["picture.late"]
    found = axis.drawn(np.linspace(0, 0.999, 100).reshape(-1, 1, 1), np.full(100, 2.0)).amount
    assert set(found.flatten().tolist()) == {0.0, 1.0, 2.0}


def test_options_are_the_severities_they_say():
    levels = composing.compose([], "stress")["levels"]
    assert {f"{g}.{name}" for g, axes in levels.items() for name in axes} == set(AXES)
    for option, severity in (("mild", 1), ("moderate", 2), ("severe", 3)):
        own = compose_settings([f"disturb={option}"]).disturb
        for group in GROUPS:
            expected = {name: row[severity - 1] for name, row in levels[group].items()}
            assert getattr(own, group) == expected, (option, group)
    for rows in levels.values():
        assert all(row == sorted(row) and len(row) == 5 for row in rows.values())
    assert compose_settings([]).disturb.amounts == {}


def test_an_axis_is_added_with_a_plus_or_without():
    for word in ("+disturb.camera.shift=0.004", "disturb.camera.shift=0.004"):
        assert compose_settings([word]).disturb.amounts == {"camera.shift": 0.004}
