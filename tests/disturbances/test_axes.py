"""Each axis does what it says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from needlehoop.config import composing
from needlehoop.disturbances import optics
from needlehoop.disturbances.axes import AXES, GROUPS, MOST_OBJECTS, Drawn, uniform
from needlehoop.disturbances.disturbance import failing
from needlehoop.disturbances.sensors import Sensors, flaws
from needlehoop.engines.contract import Frame
from needlehoop.envs.settings import compose_settings

SIDE, WIDTHS = 32, (32, 48)


def drawn(lead: tuple[int, ...], free: float = 0.5, **amounts: object) -> dict[str, Drawn]:
    """What was drawn for each axis: nothing, but for some amounts by key, a ``_`` for its dot."""
    draws = {}
    for key, axis in AXES.items():
        value = torch.as_tensor(amounts.get(key.replace(".", "_"), 0.0), dtype=torch.float64)
        amount = torch.zeros(*lead, axis.size).double() + value
        draws[key] = Drawn(amount, torch.full((*lead, axis.free), free).double())
    return draws


def frame(width: int = SIDE) -> Frame:
    """A step of colours, depth and labels in the middle; no depth in the first row."""
    bgra = torch.full((1, SIDE, width, 4), 100, dtype=torch.uint8)
    bgra[:, :, width // 2 :] = 160
    bgra[..., 3] = 255
    depth = torch.full((1, SIDE, width), 0.4)
    depth[:, 0] = 0.0
    geom = torch.zeros(1, SIDE, width, dtype=torch.int32)
    geom[..., width // 2 :] = 5
    return Frame(bgra, depth, geom)


def spoilt(seen: Frame, amounts: dict[str, float], place: float = 0.5) -> Frame:
    """What a view makes of a frame under such amounts of its axes."""
    height, width = next(one for one in seen if one is not None).shape[1:3]
    sensors = Sensors(1, ("front",), (width, height), torch.device("cpu"))
    draws = drawn((1, 1), place, **{f"picture_{name}": amount for name, amount in amounts.items()})
    sensors.set(torch.tensor([0]), **flaws(draws))
    result = Frame(*(one if one is None else one.clone() for one in seen))
    sensors.spoiler(torch.tensor([0]), torch.full((1, 3), 0.3))("front", result, slice(0, 1))
    return result


AMOUNTS = {
    "blur": (1.0, {"bgra"}),
    "brightness": (0.3, {"bgra"}),
    "contrast": (0.3, {"bgra"}),
    "cast": (0.3, {"bgra"}),
    "noise": (10.0, {"bgra"}),
    "depth_noise": (0.002, {"depth"}),
    "depth_step": (0.03, {"depth"}),
    "labels": (0.3, {"geom"}),
    "cover": (0.3, {"bgra", "depth", "geom"}),
}
"""How much of each axis is tried, and which channels it touches."""


@pytest.mark.parametrize("name", AMOUNTS)
def test_an_axis_of_pictures_touches_what_it_would_in_a_real_camera(name):
    amount, touched = AMOUNTS[name]
    seen, none = frame(), spoilt(frame(), {name: 0.0})
    flawed = spoilt(seen, {name: amount})
    for field in Frame._fields:
        assert torch.equal(getattr(none, field), getattr(seen, field))
        same = torch.equal(getattr(flawed, field), getattr(seen, field))
        assert same == (field not in touched), field
        # A camera without the other channels shows the same.
        alone = Frame(None, None, None)._replace(**{field: getattr(seen, field)})
        flawed_alone = spoilt(alone, {name: amount})
        assert torch.equal(getattr(flawed_alone, field), getattr(flawed, field))


def test_exposure_contrast_and_white_balance_act_one_after_the_other():
    image = spoilt(frame(), {"brightness": 0.1, "contrast": -0.2, "cast": 0.05}).bgra
    for before in (100.0, 160.0):
        after = ((before * 1.1 - 128.0) * 0.8 + 128.0) * 1.05
        place = 0 if before == 100.0 else -1
        assert image[0, 0, place].tolist() == [*[int(after + 0.5)] * 3, 255]


@pytest.mark.parametrize("width", WIDTHS)
def test_noise_has_its_deviation_and_differs_by_channel(width):
    seen = frame(width)
    change = (spoilt(seen, {"noise": 10.0}).bgra.float() - seen.bgra.float())[..., :3]
    assert change.std((0, 1, 2)).tolist() == pytest.approx([10.0] * 3, rel=0.1)
    assert float(change.mean().abs()) < 0.6
    assert torch.corrcoef(change.reshape(-1, 3).T).triu(1).abs().max() < 0.15


def test_depth_without_a_reading_stays_without_one():
    depth = spoilt(frame(), {"depth_noise": 0.01}).depth
    assert bool((depth[:, 0] == 0).all())
    assert float(depth[:, 1:].std()) == pytest.approx(0.01, rel=0.15)
    step = spoilt(frame(), {"depth_step": 0.03}).depth
    assert step[0, 1].tolist() == pytest.approx([0.39] * SIDE)


def test_labels_flip_along_edges_alone():
    seen = frame()
    flipped = (spoilt(seen, {"labels": 0.5}).geom != seen.geom)[0]
    assert flipped.nonzero()[:, 1].unique().tolist() == [SIDE // 2]
    # Half of them look to the left, where the other label is.
    assert float(flipped[:, SIDE // 2].float().mean()) == pytest.approx(0.25, abs=0.15)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_drop_covers_its_share(width):
    flawed = spoilt(frame(width), {"cover": 0.1})
    assert float((flawed.geom == -1).float().mean()) == pytest.approx(0.1, abs=0.01)
    at_the_corner = spoilt(frame(width), {"cover": 0.1}, place=0.0)
    assert float((at_the_corner.geom == -1).float().mean()) == pytest.approx(0.025, abs=0.01)


def test_blur_keeps_the_mean_and_blends_the_edge():
    seen = frame()
    image = spoilt(seen, {"blur": 1.0}).bgra
    assert float(image.float().mean()) == pytest.approx(float(seen.bgra.float().mean()), rel=2e-3)
    assert 100 < int(image[0, 5, SIDE // 2, 0]) < 160
    # Its width: the edge's slope is a Gaussian of 1 px, cut off at three of them.
    slope = image[0, 5, :, 0].float().diff()
    at = torch.arange(len(slope)) - (SIDE // 2 - 1)
    assert float((slope * at**2).sum() / slope.sum()) == pytest.approx(1.0, abs=0.15)
    level = Frame(seen.bgra.transpose(1, 2).contiguous(), None, None)
    assert torch.equal(spoilt(level, {"blur": 1.0}).bgra, image.transpose(1, 2))


def test_a_camera_is_shifted_turned_zoomed_and_drifts():
    """Two cameras that look elsewhere; the second is on a body, and shifts along its own axes."""
    begun = optics.rotation(torch.tensor([0.0, 0.0, np.pi / 2], dtype=torch.float64))
    start = torch.zeros(1, 2, 3, dtype=torch.float64), begun.expand(1, 2, 3, 3)

    def placed(**amounts):
        moved = optics.moved(drawn((1, 2), **amounts))
        half, on_a_body = torch.tensor([0.5]), torch.tensor([False, True])
        return (*optics.cameras(*start, moved, half, on_a_body), moved.zoom)

    by = torch.tensor([[[0.01, 0.0, 0.0], [0.0, 0.02, 0.0]]]).double()
    place = torch.tensor([[[0.01, 0.0, 0.0], [-0.02, 0.0, 0.0]]])
    assert np.allclose(placed(camera_shift=by)[0], place)
    assert np.allclose(placed(camera_drift=by)[0], place / 2)
    turn = placed(camera_turn=[[[90.0, 0.0, 0.0], [0.0, 0.0, 0.0]]])[1]
    assert np.allclose(turn[0, 0] @ torch.tensor([0.0, 1.0, 0.0]).double(), [0.0, 0.0, 1.0])
    assert torch.equal(turn[0, 1], begun)
    assert np.allclose(placed(camera_focal=[[[0.1], [-0.1]]])[2], [[1.1, 0.9]])


def test_one_view_fails_for_as_long_as_was_drawn():
    failure = Drawn(torch.tensor([[3.0]]), torch.tensor([[0.0, 0.9]]))
    fails = [failing(failure, torch.tensor([step]), 2, 100)[0].tolist() for step in range(6)]
    assert fails == [[False, False], *[[False, True]] * 3, *[[False, False]] * 2]


def test_as_many_objects_lie_about_as_were_drawn():
    count = Drawn(torch.tensor([[2.0]]), torch.full((1, 2 * MOST_OBJECTS), 0.4))
    places = optics.objects(count, 3, np.array([0.1, 0.2, 0.0]))[0].numpy()
    assert (places[:, 2] > 0).tolist() == [True, True, False]
    away = np.linalg.norm(places[:2, :2] - [0.1, 0.2], axis=-1)
    assert ((away > 0.03) & (away < 0.09)).all()


def test_numbers_depend_on_every_key_and_on_nothing_else():
    envs, no = torch.arange(1000), torch.zeros(1000, dtype=torch.int64)
    some = uniform("a", 3, 7, envs, no)
    assert torch.equal(some[5:6], uniform("a", 3, 7, torch.tensor([5]), torch.tensor([0])))
    assert abs(some.mean() - 0.5) < 0.02
    assert abs(some.std() - 12**-0.5) < 0.01
    assert abs(np.corrcoef(some.T)[0, 1]) < 0.1
    for other in (("b", 3, 7, envs, 0), ("a", 3, 8, envs, 0), ("a", 3, 7, envs, 1)):
        assert not np.isclose(uniform(*other), some).any(1).all()
    assert len(np.unique(some)) == 3000


def test_options_are_the_severities_they_say():
    levels = composing.compose([], "stress")["levels"]
    assert {f"{g}.{name}" for g, axes in levels.items() for name in axes} == set(AXES)
    for option, severity in (("mild", 1), ("moderate", 2), ("severe", 3)):
        disturb = compose_settings([f"disturb={option}"]).disturb
        for group in GROUPS:
            expected = {name: row[severity - 1] for name, row in levels[group].items()}
            assert getattr(disturb, group) == expected, (option, group)
    for rows in levels.values():
        assert all(row == sorted(row) and len(row) == 5 for row in rows.values())
    assert compose_settings([]).disturb.amounts == {}
