"""Every task that is told to a model: its own words in the general prompts."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from vlm_asked import CONFIG, QUESTIONS, Obliging, album, everything_said, text_of

from needlehoop.cli.main import main
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.pictures.stills import stages
from needlehoop.study.data.answers import read_answers
from needlehoop.tasks.needle_hoop import TASK as NEEDLE_HOOP
from needlehoop.vlm import description, inquiry
from needlehoop.vlm.config import InquiryConfig
from needlehoop.vlm.inquiry import Inquiry

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
@pytest.mark.full
def test_other_tasks_are_told_in_their_own_words(task, tmp_path):
    s = made(task)
    prompts = text_of(everything_said(s, tmp_path)).lower()
    assert not re.search(r"needle|hoop|thread", prompts)
    assert not re.search(r"\b(success|verdict|cheat|touched)\b", prompts)
    assert s.definition.cheating not in prompts
    verdicts = [name for name, row in s.definition.signals.items() if row.source == "verdict"]
    assert not [name for name in verdicts if f"- {name}" in prompts]
    # Nothing that success depends on is told.
    odd = {name: 1.0703 * getattr(s.episode, name) for name in LIMITS[task] if "steps" not in name}
    other = everything_said(replace(s, episode=replace(s.episode, **odd)), tmp_path / "odd")
    assert text_of(other).lower() == prompts


def test_a_text_too_many_or_too_few_is_named(tmp_path):
    task = replace(NEEDLE_HOOP, telling=replace(NEEDLE_HOOP.telling, texts=tmp_path))
    (tmp_path / "scene.txt").write_text("a table")
    with pytest.raises(ValueError, match=r"signals\.txt is missing or not asked for"):
        description.texts(task)
    (tmp_path / "signals.txt").write_text("- none")
    assert description.questioned(task) == {}


def test_a_task_without_words_is_refused_in_a_line(monkeypatch, elsewhere, capsys):
    mute = replace(NEEDLE_HOOP, telling=None)
    monkeypatch.setattr("needlehoop.envs.settings.find", lambda _: mute)
    assert main(["vlm", "rank", "vlm=manual", "vlm.model=m"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "task needle_hoop: no model can be asked about it; it has no telling" in line
    assert not list(elsewhere.iterdir())


@pytest.mark.parametrize("task", OTHERS)
def test_questions_on_moments_are_those_of_the_task(task, tmp_path, monkeypatch):
    s, provider = made(task), Obliging()
    monkeypatch.setattr(inquiry, "provider_of", lambda *_: provider)
    monkeypatch.setattr(inquiry, "open_album", lambda *_: album(s))
    config = InquiryConfig(str(tmp_path), "main", 64, 1, False)
    with Inquiry(s, config, CONFIG) as opened:
        result = opened.question(QUESTIONS)
    pegs = task == "peg_transfer"
    assert list(result["answers"])[3:-3] == (["lifted"] if pegs else [])
    assert len(provider.requests) == 6 + pegs
    # Two subtasks, their cameras, what shows the goal (and the moment), the layouts.
    rows = list(csv.DictReader((opened.folder / "questions.csv").read_text().splitlines()))
    texts = [row["question"] for row in rows if " to see that " in row["question"]]
    moments = ["the goal is reached", *(["the block is lifted"] if pegs else [])]
    assert texts == [f"Best {w} to see that {so}" for so in moments for w in ("view", "rendering")]
    answers = read_answers(opened.folder)
    assert answers is not None
    assert [one.question for one in answers.questions] == [row["question"] for row in rows]


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
