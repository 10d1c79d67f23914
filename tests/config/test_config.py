from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import yaml
from strength import ALL

from needlehoop.config import composing
from needlehoop.envs.settings import compose_settings, settings_from
from needlehoop.learning.job import typed_job
from needlehoop.runs.files import reward_name
from needlehoop.runs.run import Run
from needlehoop.scene.cameras import pose_of

GROUPS = ("task", "episode", "reward", "engine", "obs", "disturb")
TRAINING = ("algo", "encoder", "collector")
COMMANDS = {"gates": "check", "vlm": "ask", "levels": "stress"}
"""Groups that a command's config has, by command."""


def options(group: str) -> list[str]:
    return sorted(file.stem for file in (composing.CONF / group).glob("*.yaml"))


def every(groups: Iterable[str]) -> list[tuple[str, str]]:
    return [(group, option) for group in groups for option in options(group)]


VIEWS = sorted(file.stem for file in (composing.CONF / "view").rglob("*.yaml"))
CAMERAS = " ".join([*(f"{r}_{v}" for r in options("rendering") for v in VIEWS), *options("cams")])
UNKNOWN = ("rgb_top", "[rgb_front,rgb_top]")

BAD = [
    # Words, then what the message has to say: the key, and what would be valid.
    *((f"cams={wrong}", ["cams/", wrong.strip("[]").split(",")[-1], CAMERAS]) for wrong in UNKNOWN),
    ("cams=[rgb_front,seg_side,rgb_front]", ["cams", "rgb_front", "twice"]),
    ("reward=nope", ["reward", "nope", "human", "sparse"]),
    ("task=nope", ["task", "nope", "near", "standard", "wide"]),
    ("episode.grasp=glue", ["episode.grasp", "glue", "weld, friction"]),
    ("renderings.dep.depth=far", ["renderings.dep", "depth", "far", "channel, shade, none"]),
    ("task.needle_radius=-0.01", ["task.needle_radius", "-0.01", "at least 1e-05"]),
    ("task.workspace_lower=[0,0.5,0]", ["task.workspace_lower", "0.5", "below"]),
    ("task.hoop_position=[0,0,high]", ["task.hoop_position.2", "high"]),
    ("disturb.camera.shfit=0.1", ["shfit", "shift, turn"]),
    ("image_size=64.5", ["image_size", "64.5", "whole number"]),
    ("image_size=[80]", ["image_size: ", "neither the side of a square nor"]),
    ("image_size=[80,0]", ["image_size: ", "0 must be at least 1"]),
    ("image_size=[80,63]", ["image_size: ", "width and height must differ by an even number"]),
    (
        "cams=dep_wrist +views.wrist.azimuth=0",
        ["views", "azimuth, position, forward, up given; give either target, ", " or position, "],
    ),
    (
        "cams=dep_wrist views.wrist.up=[0,0.4158,1.9562]",
        ["views.wrist: view.up: ", " along forward"],
    ),
    (
        "disturb.scene.colours=0.1 engine.renderer=tracer",
        ["disturb.scene.colours: only engine.renderer=rasteriser"],
    ),
    *(
        (f"reward=python reward.function={name}", ["reward.function: ", message])
        for name, message in (
            ("half", "is not module:name"),
            ("nowhere.py:half", "nowhere.py"),
            ("needlehoop.rewards:no_such", "has no function 'no_such'"),
        )
    ),
    (
        "obs.privileged_facts=[threaded]",
        ["obs.privileged_facts", "threaded", "choose from grasped, lifted"],
    ),
    ("imagesize=64", ["imagesize", "unknown", "image_size", "num_envs"]),
    ("+reward.extra=1", ["reward", "extra", "closed_below"]),
]


def test_a_bad_setting_is_refused_with_its_key_and_what_is_valid():
    for words, parts in BAD:
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            compose_settings(words.split())
        message = str(caught.value)
        assert [part for part in parts if part not in message] == [], words
        assert "\n" not in message, words


def test_every_option_of_every_group_composes(tmp_path):
    (tmp_path / "mine.txt").write_text("reward = 1 * grasped")
    (tmp_path / "mine.py").write_text("def paid(signals):\n    return signals.grasped.double()\n")
    # What an option can't do without.
    more = {
        "file": [f"reward.path={tmp_path}/mine.txt"],
        "python": [f"reward.function={tmp_path}/mine.py:paid"],
        "vlm_img": ["cams=[dep_front,seg_side]"],
        "vlm_img_claude": ["cams=[dep_front,seg_side]"],
    }
    for group, option in every(GROUPS):
        task = [f"task={option}"] if group == "episode" and option in options("task") else []
        composed = composing.compose([f"{group}={option}", *task, *more.get(option, [])])
        assert composed[group], option
        settings_from(composed)
        # What a plan of runs takes for granted.
        assert group != "reward" or reward_name(composed[group]) == option

    for group, option in every(COMMANDS):
        more = ["vlm.model=qwen"] if option in ("openai", "manual") else []
        assert composing.compose([f"{group}={option}", *more], COMMANDS[group])[group], option
    for group, option in every(TRAINING):
        composed = composing.compose(["cams=[seg_side]", f"{group}={option}"], "config")
        assert composed[group], option
        typed_job(composed)


def test_every_view_and_rendering_is_offered(settings):
    assert sorted(settings.views) == options("view")
    assert sorted(settings.renderings) == options("rendering")
    names = [f"{r}_{v}" for r in options("rendering") for v in VIEWS]
    every = compose_settings([f"cams=[{','.join(names)}]"])
    assert [camera.name for camera in every.cameras] == names
    assert ("rgb", "ecm_left") in {(c.rendering, c.view) for c in every.cameras}


@pytest.mark.parametrize(
    ("words", "chosen"),
    [
        ([], []),
        (["cams=[]"], []),
        (["cams=seg_side,dep_front"], ["seg_side", "dep_front"]),
        (["cams=[dep_front,seg_side]"], ["dep_front", "seg_side"]),
        (["+cams=dep_front"], ["dep_front"]),
        (["cams=dep_front", "reward=vlm_text"], ["dep_front"]),
    ],
)
def test_chosen_cameras_are_a_plain_list_in_their_order(words, chosen):
    values = composing.compose(words, "config")
    assert values["cams"] == chosen
    assert values["reward"].get("cams", chosen) == chosen
    assert "cameras" not in values


KEPT = sorted((Path(__file__).parents[2] / "results").glob("*/*/*/seed*/config.yaml"))


@pytest.mark.skipif(not KEPT, reason="no runs are kept here")
def test_every_kept_run_is_read_as_it_was_written():
    for path in KEPT if ALL else KEPT[::12]:
        values = Run.open(path.parent).config()
        job = typed_job(values)
        written = yaml.load(path.read_text(), yaml.CSafeLoader)
        assert job.env.engine.renderer == written["engine"]["renderer"], path
        assert list(job.env.cams) == values["cams"], path
        # It was a study of its own name when it was trained.
        assert path.parts[-4:-1] == tuple(job.place.split("/")[1:]), path


@pytest.mark.parametrize(
    ("words", "views"),
    [
        (["cams=rgb_front"], []),
        (["cams=[rgb_wrist,dep_wrist]"], ["wrist"]),
        (["cams=stereo"], ["ecm_left", "ecm_right"]),
        (["views.wrist.fovy=60"], ["wrist"]),
    ],
)
def test_a_view_of_a_folder_is_part_of_a_config_that_names_it(words, views):
    composed = composing.compose(words, "config")["views"]
    probe_words = ["combinations=rgb_front+dep_wrist", "views.wrist.fovy=60"]
    probed = composing.compose(probe_words, "probe")["views"]
    assert [*composed] == [*options("view"), *views]
    assert ([*probed], probed["wrist"]["fovy"]) == ([*options("view"), "wrist"], 60)


def test_stereo_is_both_eyes_side_by_side():
    chosen = compose_settings(["cams=[stereo,dep_front]"])
    assert chosen.cams == ("rgb_ecm_left", "rgb_ecm_right", "dep_front")
    (left, turn), (right, same) = (pose_of(chosen.views[f"ecm_{e}"]) for e in ("left", "right"))
    # The baseline is along the images' rows, which is the world's x here: EndoNeRF's 4.32 mm.
    assert np.array_equal(turn, same)
    assert np.allclose(right - left, [0.00432, 0.0, 0.0], atol=1e-12)
