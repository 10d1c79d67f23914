"""Every task that is told to a model: its own words in the general prompts, and its gates."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from vlm_asked import CONFIG, QUESTIONS, RULES, Obliging, everything_said, text_of

from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.pictures.stills import stages
from needlehoop.study.data.answers import read_answers
from needlehoop.tasks.needle_hoop import TASK as NEEDLE_HOOP
from needlehoop.tasks.registry import find
from needlehoop.vlm import album, description, inquiry
from needlehoop.vlm.album import Album
from needlehoop.vlm.config import InquiryConfig
from needlehoop.vlm.inquiry import Inquiry
from needlehoop.vlm.messages import Png
from needlehoop.vlm.record import EDITION
from needlehoop.vlm.writing import reward_prompt

OTHERS = ("reach", "peg_transfer")
LIMITS = {
    "reach": ("near_radius", "near_steps"),
    "peg_transfer": ("arrive_radius", "rest_gap", "rest_tilt", "rest_speed", "rest_spin"),
}
"""Rules by which success is decided."""


def made(task: str, variant: str = "standard", *words: str) -> Settings:
    chosen = [f"task={task}/{variant}", f"episode={task}", "engine.threads=1", *words]
    return compose_settings(chosen)


@pytest.mark.parametrize("task", OTHERS)
def test_every_variant_is_told(task):
    for variant, control in (("standard", "tip"), ("near", "pose"), ("wide", "tip")):
        s = made(task, variant, f"episode.control={control}")
        (said,) = reward_prompt(s, RULES)
        assert "$" not in said
        assert ("about each of them" in said) == (control == "pose")


@pytest.mark.parametrize("task", OTHERS)
@pytest.mark.full
def test_other_tasks_are_told_in_their_own_words(task, tmp_path):
    s = made(task)
    said = text_of(everything_said(s, tmp_path)).lower()
    assert not re.search(r"needle|hoop|thread", said)
    assert not re.search(r"\b(success|verdict|cheat|touched)\b", said)
    assert s.definition.cheating not in said
    for name in LIMITS[task]:
        assert name not in said
    own = [name for name, row in s.definition.signals.items() if row.source == "verdict"]
    assert not [name for name in own if f"- {name}" in said]
    # Nothing that success depends on is told.
    odd = {name: 1.0703 * getattr(s.episode, name) for name in LIMITS[task] if "steps" not in name}
    other = everything_said(replace(s, episode=replace(s.episode, **odd)), tmp_path / "odd")
    assert text_of(other).lower() == said


@pytest.mark.parametrize(
    ("task", "change", "said"),
    [
        ("reach", {"target_height": 0.0093}, "9.3 mm above the top of the column"),
        ("reach", {"bump_height_range": 0.0021}, "heights 9.9 to 14.1 mm"),
        ("reach", {"clearance": 0.0031}, "3.1 mm above the middle of the button"),
        ("peg_transfer", {"marked_height": 0.0133}, "is 13.3 mm high"),
        ("peg_transfer", {"starts": (2,)}, "one of these: (-12, 8). The marked"),
        ("peg_transfer", {"pickup_depth": 0.0051}, "5.1 mm below its upper edge"),
        ("peg_transfer", {"hole_radius": 0.0071}, "a cylinder of 7.1 mm radius"),
    ],
)
def test_their_numbers_come_from_the_settings(task, change, said):
    s = made(task)
    changed = replace(s, task=replace(s.task, **change))
    (told,), (before,) = (reward_prompt(one, RULES) for one in (changed, s))
    assert said in told
    assert said not in before


@pytest.mark.parametrize("change", [{"done": "elsewhere"}, {"goal": "gone"}, {"moments": {}}])
def test_an_edition_is_of_a_task_and_of_all_that_is_said_of_it(change, tmp_path):
    others = {description.edition_of(find(name)) for name in OTHERS}
    assert len(others | {description.edition_of(NEEDLE_HOOP)}) == 3
    # A moment's own question would have no moment.
    shutil.copytree(NEEDLE_HOOP.telling.texts, tmp_path, dirs_exist_ok=True)
    (tmp_path / "lifted.txt").unlink()
    task = replace(NEEDLE_HOOP, telling=replace(NEEDLE_HOOP.telling, texts=tmp_path))
    told = replace(task, telling=replace(task.telling, **change))
    assert (
        description.edition_of(told)
        != description.edition_of(task)
        != description.edition_of(NEEDLE_HOOP)
    )


def test_a_text_too_many_or_too_few_is_named(tmp_path):
    own = replace(NEEDLE_HOOP.telling, texts=tmp_path)
    task = replace(NEEDLE_HOOP, telling=own)
    (tmp_path / "scene.txt").write_text("a table")
    with pytest.raises(ValueError, match=r"signals\.txt is missing or not asked for"):
        description.texts(task)
    (tmp_path / "signals.txt").write_text("- none")
    assert description.questioned(task) == {}
    (tmp_path / "sceen.txt").write_text("a table")
    with pytest.raises(ValueError, match=r"sceen\.txt is missing or not asked for"):
        description.texts(task)
    with pytest.raises(ValueError, match="needle_hoop: telling: no 'held' among grasped"):
        replace(NEEDLE_HOOP, telling=replace(own, moments={"held": "it is held"}))


def test_a_task_without_words_is_refused_in_a_line(settings, monkeypatch, tmp_path, capsys):
    from needlehoop.cli.main import main

    monkeypatch.setattr("needlehoop.envs.settings.find", lambda _: mute)
    monkeypatch.chdir(tmp_path)
    mute = replace(NEEDLE_HOOP, telling=None)
    for words in (["question"], ["rank"], ["reward", "cams=rgb_default"]):
        assert main(["vlm", *words, "vlm=manual", "vlm.model=m"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "task needle_hoop: no model can be asked about it; it has no telling" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("task", OTHERS)
def test_questions_on_moments_are_those_of_the_task(task, tmp_path, monkeypatch):
    s, provider = made(task), Obliging()
    names = [f"{r}_{view}" for r in s.renderings for view in s.views]
    shown = {
        state: {n: Png(n.encode()) for n in names}
        for state in (*description.stages_of(s.definition), "seen")
    }
    monkeypatch.setattr("needlehoop.vlm.providers.server.Server", lambda _: provider)
    monkeypatch.setattr(inquiry, "open_album", lambda *_: Album(shown, 64))
    config = InquiryConfig(str(tmp_path), "main", 64, 1, False)
    with Inquiry(s, config, CONFIG) as opened:
        found = opened.question(QUESTIONS)
    pegs = task == "peg_transfer"
    assert list(found["answers"])[3:-3] == (["lifted"] if pegs else [])
    assert len(provider.asked) == 6 + pegs
    # Two subtasks, their cameras, what shows the goal (and the moment), the layouts.
    rows = list(csv.DictReader((opened.folder / "questions.csv").read_text().splitlines()))
    asked = [row["question"] for row in rows if " to see that " in row["question"]]
    wanted = ["the goal is reached", *(["the block is lifted"] if pegs else [])]
    assert asked == [f"Best {w} to see that {so}" for so in wanted for w in ("view", "rendering")]
    answers = read_answers(opened.folder)
    assert answers is not None
    assert [one.question for one in answers.questions] == [row["question"] for row in rows]
    noted = json.loads((Path(opened.folder) / EDITION).read_text())
    assert noted["sha256"] == description.edition_of(s.definition)


def test_pictures_are_of_the_start_the_tasks_moments_and_the_goal():
    assert [*description.stages_of(NEEDLE_HOOP)] == ["start", "grasped", "lifted", "goal"]
    assert [*description.stages_of(find("reach"))] == ["start", "goal"]
    taken = album._take(replace(made("reach"), image_size=16), 16)
    assert list(taken) == ["start", "goal", album.SEEN]


def test_in_the_picture_of_the_goal_the_needle_is_through():
    """From the side, its sharp end stands out beyond the ring."""
    s = compose_settings(["engine.threads=1", "cams=[seg_side]", "image_size=256"])
    image = stages(s, "goal")["goal"]["seg_side"]
    colours = s.renderings["seg"].colours
    leftmost = {
        name: min(np.nonzero((image == np.array(colours[name])[:, None, None]).all(0))[1])
        for name in ("needle", "hoop")
    }
    assert leftmost["needle"] < leftmost["hoop"]
