"""Views on a body, which move with it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from needlehoop.engines.contract import FIELDS, Channels
from needlehoop.engines.rasteriser.renderer import CpuRasteriser
from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
from needlehoop.scene.cameras import View, pose_of
from needlehoop.vlm import description

WRIST = ["cams=[dep_wrist]", "num_envs=3", "image_size=32", "seed=2"]


def matrix(quaternion: np.ndarray) -> np.ndarray:
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def at(view: View, position: np.ndarray, forward: np.ndarray, up: np.ndarray) -> View:
    """A view of the same lens at another place."""
    place = {"position": position, "forward": forward, "up": up}
    lens = {"fovy": view.fovy, "near": view.near, "far": view.far}
    return View(**{key: tuple(value.tolist()) for key, value in place.items()}, **lens)


def moved(*words: str):
    """A simulation of three environments after a few steps, each its own way."""
    simulation = build(compose_settings([*WRIST, *words]))
    simulation.reset()
    chance = torch.Generator().manual_seed(0)
    for _ in range(8):
        simulation.step(torch.rand(3, 5, generator=chance, dtype=torch.float64) * 2 - 1)
    return simulation


@pytest.mark.parametrize("psm", ["serial", "parallelogram"])
def test_it_is_drawn_from_where_its_body_is_now_in_each_environment(psm):
    simulation = moved(f"psm={psm}", "disturb.camera.shift=0.01")
    assert simulation.disturbance._mounted.tolist() == [True]
    engine, view = simulation.engine, simulation.settings.views["wrist"]
    frames, places = engine.render()["wrist"], []
    position, quaternion = pose_of(view)
    for env in range(3):
        data = engine.data(env)
        camera, body = data.camera("wrist"), data.body("roll")
        turn = body.xmat.reshape(3, 3)
        assert np.allclose(camera.xpos, body.xpos + turn @ position, atol=1e-12)
        assert np.allclose(camera.xmat.reshape(3, 3), turn @ matrix(quaternion), atol=1e-12)
        alone = CpuRasteriser(engine.model, 1, {"wrist": Channels(True, True, False)}, 32, 1)
        seen = alone.render({name: torch.tensor(getattr(data, name)[None]) for name in FIELDS})[
            "wrist"
        ]
        assert torch.equal(frames.bgra[env], seen.bgra[0])
        assert torch.equal(frames.depth[env], seen.depth[0])
        places.append(camera.xpos.copy())
    apart = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (apart > 1e-3).all()


def test_a_body_that_there_is_not_is_refused_by_its_key():
    message = r"views.wrist.body: 'elbow' is unknown; choose from psm_base, yaw, .*roll.*needle"
    with pytest.raises(ValueError, match=message):
        build(compose_settings([*WRIST, "views.wrist.body=elbow"]))


def test_both_ways_of_placing_and_the_roll_are_one_geometry(settings):
    for name in settings.views:
        view = settings.views[name]
        position, quaternion = pose_of(view)
        right, up, back = matrix(quaternion).T
        same = at(view, position, -2 * back, up - back)
        assert np.allclose(matrix(pose_of(same)[1]), matrix(quaternion), atol=1e-12)
        turned = pose_of(replace(view, roll=90.0))
        assert np.array_equal(turned[0], position)
        # Anticlockwise: what was at its left is up now.
        assert np.allclose(matrix(turned[1]).T, [up, -right, back], atol=1e-12)


def test_a_model_is_told_what_it_is_mounted_on():
    settings = compose_settings(WRIST)
    task, wrist = settings.definition, settings.views["wrist"]
    shaft = "mounted on the instrument's shaft, with which it moves and turns, looking along it"
    assert description.view(wrist, task, 64).startswith(shaft)
    text = description.view(replace(wrist, body="jaw_1", roll=30.0), task, 64)
    assert text.startswith("mounted on the moving body jaw_1, ")
    assert "turned by 30 degrees about its line of sight; at 107 mm from it its image is " in text
