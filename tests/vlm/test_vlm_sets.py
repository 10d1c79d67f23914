"""Any camera sets, and pictures of a real bench: ranked in groups, put together."""

from __future__ import annotations

import json
import runpy
from collections import Counter
from itertools import combinations
from pathlib import Path

import pytest
from PIL import Image

from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.envs.settings import settings_from
from needlehoop.runs.shipped import CONF
from needlehoop.vlm.questions import deal, of_groups, strengths

NAMES = [f"rgb_p{number:02d}" for number in range(1, 21)]


def test_each_name_is_asked_about_once_a_round():
    groups = deal(NAMES, 5, 4)
    assert [len(group) for group in groups] == [5] * 16
    assert set(Counter(name for group in groups for name in group).values()) == {4}
    assert sorted(map(len, deal(NAMES[:11], 5, 1))) == [3, 4, 4]
    assert deal(NAMES[:5], 5, 4) == [NAMES[:5]]


def test_a_long_list_is_put_in_the_order_of_its_groups():
    names = NAMES[::-1]
    answers = [
        {"places": [{"name": n, "reason": "r"} for n in sorted(dealt)], "sure": [0.9] * 4}
        for dealt in deal(names, 5, 4)
    ]
    result = of_groups(names, 5, 4, answers)
    order = [place["name"] for place in result["rankings"][0]]
    assert sum(a > b for a, b in combinations(order, 2)) < 19, order
    assert (order[0], order[-1]) == ("rgb_p01", "rgb_p20")
    assert all(0.5 <= value < 1 for value in result["sure"][0])
    # Names that a model cannot tell apart are as strong as each other.
    tied = {"places": [{"name": name} for name in "abc"], "sure": [0.5, 0.8]}
    found = strengths("abc", [tied])
    assert found["a"] == found["b"] > found["c"] > 0


def test_the_placements_are_what_is_drawn_and_no_cameras_elsewhere():
    script = runpy.run_path(str(CONF.parent / "benchmarks/placements.py"))
    assert (CONF / "experiment/placements.yaml").read_text() == script["text"](0)
    places = script["drawn"](0)[0].values()
    assert min(script["angle"](a, b) for a, b in combinations(places, 2)) >= 15
    words = ["+experiment=placements", "cams=[rgb_p01,rgb_p20]"]
    settings = settings_from(composing.compose(words, "config"))
    assert [camera.view for camera in settings.cameras] == ["p01", "p20"]
    with pytest.raises(ValueError, match="p01"):
        composing.compose(["cams=[rgb_p01]"], "config")


def test_any_sets_are_ranked_with_their_places_in_words(words, server):
    chosen = ["sets=[rgb_side,dep_front,segdep_front]", "group=2", "rounds=2"]
    assert main(["vlm", "rank", *chosen, *words]) == 0
    (ranking,) = json.loads(Path("results/main/vlm/rankings_sets.json").read_text())["lists"]
    assert sorted(ranking["combinations"]) == ["dep_front", "rgb_side", "segdep_front"]
    assert sorted(len(q["sets"]) for q in ranking["questions"]) == [1, 1, 2, 2]
    assert "45 degrees round from the front of the hoop" in json.dumps(server.requests)
    shown = json.loads(Path("results/main/vlm/pictures.json").read_text())["pictures"]
    assert "rgb_default" not in shown["start"]


def test_pictures_of_a_bench_are_ranked_without_a_simulator(words, server, tmp_path, monkeypatch):
    folder = tmp_path / "bench"
    folder.mkdir()
    for name, colour in (("left", "red"), ("top", "blue"), ("wrist", "green")):
        Image.new("RGB", (64, 40), colour).save(folder / f"{name}.jpg")
    (folder / "about.txt").write_text("A gripper puts a nut on a bolt.")
    monkeypatch.setattr("needlehoop.vlm.inquiry.open_album", None)
    assert main(["vlm", "rank", f"pictures={folder}", *words]) == 0
    (ranking,) = json.loads(Path("results/main/vlm/rankings_pictures.json").read_text())["lists"]
    assert ranking["combinations"] == ["left", "top", "wrist"]
    (request,) = server.requests
    text = json.dumps(request)
    assert "A gripper puts a nut on a bolt." in text
    assert "needle" not in text.replace("needlehoop", "")
    assert text.count("image/png") == 3


def test_a_mistake_names_the_key(words, server, capsys):
    Path("broken").mkdir()
    for name in "ab":
        Path(f"broken/{name}.png").write_bytes(b"nothing")
    for argument, message in (
        ("pictures=results", "two or more pictures"),
        ("pictures=broken", "image file 'broken/a.png'"),
        ("sets=[rgb_front,rgb_top]", "sets: rgb_top: "),
    ):
        Path("results").mkdir(exist_ok=True)
        assert main(["vlm", "rank", argument, *words]) == 2
        assert message in capsys.readouterr().err
    assert server.requests == []
