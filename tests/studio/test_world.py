"""The world behind the page, and what is made of its cameras; no browser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from needlehoop.config import composing
from needlehoop.envs.build import build
from needlehoop.envs.controllers import by_name
from needlehoop.envs.settings import compose_settings
from needlehoop.scene.cameras import pose_of
from needlehoop.studio.judging import probe_scores, ranking_question, visibility
from needlehoop.studio.placing import aimed, posed, save
from needlehoop.studio.players import BY_HAND, SHIPPED, Hand, Player, players
from needlehoop.studio.world import World

LEVELS = composing.compose((), "studio")["levels"]
DOWN = np.array((1.0, 0.0, 0.0, 0.0))
"""The quaternion of a camera that looks down."""
CPU = torch.device("cpu")


@pytest.fixture
def world(settings) -> World:
    choices = {"expert": Player(by_name("expert"))}
    return World(settings, choices, LEVELS, "rgb", "expert", size=128)


def agents(settings, view="front"):
    """What ``build`` gives for the same camera at the same moment: the agent's own image."""
    simulation = build(replace(settings, num_envs=1, cams=(f"rgb_{view}",)))
    simulation.reset()
    return simulation.images()[f"rgb_{view}"][0].permute(1, 2, 0).numpy()


def test_pictures_are_the_agents_own_pixels(world, settings):
    frame = world.tick()
    picture = frame.pictures["front"]
    assert picture.shape == (128, 256, 3)
    np.testing.assert_array_equal(picture[::2, :128:2], agents(settings))
    np.testing.assert_array_equal(picture[::2, :128], picture[1::2, :128])
    finer = agents(replace(settings, image_size=128))
    np.testing.assert_array_equal(picture[:, 128:], finer)
    assert world.tick() is None, "nothing changed, so nothing is sent"


def test_a_moved_camera_shows_what_training_with_it_shows(world, settings):
    world.tick()
    view = settings.views["front"]
    moved = replace(posed(view, np.array((0.05, -0.4, 0.2)), pose_of(view)[1]), fovy=25.0)
    world.place("front", moved)
    there = replace(settings, views={**settings.views, "front": moved})
    np.testing.assert_array_equal(world.tick().pictures["front"][::2, :128:2], agents(there))


def test_the_episode_goes_on_when_a_camera_is_moved(world, settings):
    world.tick()
    for _ in range(5):
        world.step()
        world.tick()
    before = world._frame(world.wish).position
    world.place("front", aimed(settings.views["front"], np.array((0.01, 0.0, 0.02))))
    frame = world.tick()
    assert frame.status.startswith("step 5 of")
    np.testing.assert_array_equal(frame.position, before)
    world.restart()
    assert world.tick().status.startswith("step 0 of")


def test_a_disturbance_is_seen_at_once_and_goes_away(world):
    first = world.tick().pictures["front"]
    world.disturb("picture.brightness", 5)
    changed = world.tick().pictures["front"]
    assert (changed[:, :128] != first[:, :128]).any()
    assert (changed[:, 128:] != first[:, 128:]).any()
    world.disturb("none", 5)
    np.testing.assert_array_equal(world.tick().pictures["front"], first)


def test_sliders_bring_the_tip_and_the_jaw_there(world):
    tip = world.tick().hand.tip
    goal = (tip[0] + 0.01, tip[1] - 0.005, tip[2])
    world.reach(Hand(goal, 0.5))
    for _ in range(10):
        frame = world.tick()
    assert frame.wish.player == BY_HAND
    np.testing.assert_allclose((*frame.hand.tip, frame.hand.jaw), (*goal, 0.5), atol=1e-9)


def test_the_shipped_agent_plays_to_the_end_and_begins_again(settings):
    choices = players(settings, None, False, CPU)
    world = World(settings, choices, LEVELS, "rgb", SHIPPED, size=64)
    world.set(seed=1)
    world.play(True)
    frames = [world.tick() for _ in range(settings.episode.max_steps)]
    last = [frame for frame in frames if frame is not None][-1]
    assert "success" in last.status
    assert last.wish.ahead == 0
    world.play(True)
    assert world.tick().status.startswith("step 1 of")


def test_a_runs_policies_can_be_chosen(tiny_run):
    settings = compose_settings(["episode.max_steps=3", "episode.substeps=2"])
    choices = players(settings, tiny_run, False, CPU)
    assert {"last policy", "best policy"} <= set(choices)
    world = World(settings, choices, LEVELS, "seg", "best policy", size=64)
    world.step()
    assert world.tick().status.startswith("step 1 of 3")


def test_a_pose_becomes_the_same_view_and_is_aimed_with_z_up(settings):
    for view in settings.views.values():
        position, quaternion = pose_of(view)
        again = pose_of(posed(view, position, quaternion))
        np.testing.assert_allclose(again[0], position, atol=1e-5)
        assert abs(again[1] @ quaternion) == pytest.approx(1.0, abs=1e-8)
    down = posed(settings.views["side"], np.array((0.1, -0.2, 0.3)), DOWN)
    aim = aimed(down, np.array((0.0, 0.0, 0.02)))
    np.testing.assert_allclose(aim.forward, np.array((-0.1, 0.2, -0.28)) / 0.1284**0.5, atol=1e-5)
    assert aim.up == (0.0, 0.0, 1.0)


def test_a_saved_view_is_one_to_train_with(settings, tmp_path):
    view = posed(settings.views["front"], np.array((0.05, -0.4, 0.2)), DOWN)
    folder = str(tmp_path / "mine")
    save(view, "corner", folder, overwrite=False)
    chosen = compose_settings([f"conf_dir={folder}", "cams=rgb_corner"])
    assert (chosen.cams, chosen.views["corner"]) == (("rgb_corner",), view)


def test_a_view_replaces_no_file_unasked(settings, tmp_path):
    view = settings.views["front"]
    path = save(view, "mine", str(tmp_path), overwrite=False)
    with pytest.raises(ValueError, match="mine"):
        save(view, "mine", str(tmp_path), overwrite=False)
    save(replace(view, fovy=30.0), "mine", str(tmp_path), overwrite=True)
    assert yaml.safe_load(path.read_text())["fovy"] == 30.0
    for name in ("front", "no name"):
        with pytest.raises(ValueError, match="name"):
            save(view, name, str(tmp_path), overwrite=True)


def test_pixels_and_what_is_hidden(settings):
    away = posed(settings.views["front"], np.array((0.0, -0.4, 0.1)), DOWN)
    counts = visibility(replace(settings, views={"side": settings.views["side"], "down": away}))
    assert list(counts) == ["side", "down"]
    assert list(counts["side"]) == list(settings.definition.paint)
    robot = counts["side"]["robot"]
    assert 100 < robot.pixels < 64 * 64
    assert 0.0 <= robot.hidden < 0.2
    assert max(seen.hidden for seen in counts["side"].values()) > robot.hidden
    # A camera that looks at the table beside everything shows nothing.
    assert all(seen.pixels == 0 and np.isnan(seen.hidden) for seen in counts["down"].values())


def test_the_probe_scores_each_camera_and_all(settings):
    shares = []
    tiny = {"episodes": {"train": 4, "held_out": 4, "per_phase": 2}}
    tiny |= {"fit": {"updates": 2, "minibatch": 8, "learning_rate": 1e-3}}
    cams = ("rgb_front", "rgb_side")
    scores = probe_scores(settings, cams, shares.append, **tiny)
    assert set(scores) == {"rgb_front", "rgb_side", "rgb_front+rgb_side"}
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_question_is_written_and_its_answer_read(settings, tmp_path):
    cams = ("rgb_front", "rgb_side")
    arguments = (settings, cams, str(tmp_path))
    folder, order = ranking_question(*arguments)
    (place,) = (folder / "asked").iterdir()
    assert order == []
    assert "rgb_side" in (place / "request.md").read_text()
    (place / "answer.json").write_text(
        '{"places": [{"name": "rgb_side", "reason": "a"}, {"name": "rgb_front", "reason": "b"}],'
        ' "sure": [0.8]}'
    )
    assert ranking_question(*arguments) == (folder, ["rgb_side", "rgb_front"])
