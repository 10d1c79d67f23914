"""What a model is told, and what it must not be."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from vlm_asked import Obliging, everything_said, text_of

from needlehoop.config import composing, strict
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings
from needlehoop.rewards import NONE
from needlehoop.rewards.language.program import MAX_EXPONENT
from needlehoop.robot import geometry as geo
from needlehoop.scene import signals as scene_signals
from needlehoop.scene.cameras import View
from needlehoop.tasks.needle_hoop import TASK, sharp_end_is_nearer
from needlehoop.tasks.needle_hoop.expert import Expert
from needlehoop.tasks.needle_hoop.facts import centre_line
from needlehoop.tasks.needle_hoop.reward import Human
from needlehoop.vlm import description
from needlehoop.vlm.album import all_channels
from needlehoop.vlm.config import Gates
from needlehoop.vlm.conversation import Conversation, NoAnswerError
from needlehoop.vlm.messages import Request
from needlehoop.vlm.record import Record
from needlehoop.vlm.writing import program_rules, reward_prompt, write_program


@pytest.fixture(scope="module")
def requests(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> list[Request]:
    return everything_said(settings, tmp_path_factory.mktemp("record"))


BAD = (
    "import os",
    "reward = 3",
    "reward = 40",
    "reward = 1 / elapsed",
    "reward = 9 * exp(-50 * distance(needle_tip, goal))",
    "reward = 2",
)


@pytest.fixture(scope="module")
def corrected(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> list[Request]:
    """Requests for a reward of a model that never gets it right, with the real judge."""
    gates = strict.value(composing.compose([], "check"), "gates", Gates)
    gates = replace(gates, episodes=1, random_signals=50, random_episodes=1, stop_episodes=1)
    gates = replace(gates, audit="refuse")
    quick = replace(settings, engine=replace(settings.engine, threads=1))
    rules = program_rules(quick, gates)
    programs = [json.dumps({"explanation": "e", "program": program}) for program in BAD]
    provider = Obliging(programs)
    record = Record(tmp_path_factory.mktemp("bad"), provider)
    conversation = Conversation(record, "reward", len(BAD))
    with pytest.raises(NoAnswerError):
        write_program(conversation, rules, reward_prompt(settings, rules))
    return provider.requests


def test_with_less_told_no_word_of_the_task_is_said(requests):
    """Names of signals and of colours are told with ``names``, and with ``nothing`` no camera's."""
    full, names, nothing = (text_of([request]).lower() for request in requests[10:13])
    assert "through a hoop" in full
    for text in (names, nothing):
        assert "through a hoop" not in text
        assert not re.search(r"\b(surgery|table|sharp|curved)\b", text)
        assert "rgb_default, stage 1:" in text
        assert "stage 4: the task is done" in text
    assert "pickup_point   3       m       world" in names
    assert not re.search(r"needle|hoop|grasp|lift|signal|depth|grey", nothing)
    rewards = [text_of([request]).lower() for request in (*requests[13:15], requests[16])]
    for text in rewards:
        assert "when the task is done" in text
        assert "pickup_point   3       m       world" in text
        assert not re.search(r"through a hoop|surgery|\btable\b|should be grasped|is held", text)
    assert "What do you take the task to be?" in text_of(requests[15:16])


def test_a_picture_has_all_that_the_agent_is_given(settings):
    """A depth channel stands beside the colours, not in their place."""
    colours = np.arange(3 * 96 * 96).reshape(3, 96, 96).astype(np.uint8)
    depth = np.full((1, 96, 96), 77, np.uint8)
    kinds = settings.renderings
    both = all_channels(np.concatenate((colours, depth)), kinds["dep"])
    assert both.shape == (96, 96 + 2 + 96, 3)
    assert (both[:, :96] == colours.transpose(1, 2, 0)).all()
    assert (both[:, 98:] == 77).all()
    assert all_channels(depth, replace(kinds["dep"], colour="none")).shape == (96, 96, 3)


def test_a_reward_prompt_says_what_signals_and_functions_are(requests):
    reward = text_of(requests[8:9])
    assert scene_signals.describe(scene_signals.vocabulary(TASK.signals)) in reward
    assert "distance(u, v): Euclidean distance" in reward
    for fact in ("60 % of its length", "between 0 and 9", "starts at 1.3 rad", "1/100"):
        assert fact in reward
    assert f"of at most {MAX_EXPONENT}." in reward


def test_shades_are_told_with_their_distances_by_view(settings):
    kinds, views = settings.renderings, settings.views

    def text(name: str, **cameras: View) -> str:
        return description.rendering(kinds[name], TASK.telling, cameras or views)

    assert "needle (255, 230, 0)" in text("seg")
    assert "from full brightness at 320 mm to 15 % of it at 480 mm" in text("segdep")
    # Greys of views that differ in them are told by view.
    greys = text("dep", front=views["front"], side=replace(views["side"], near=0.1))
    assert "255 (white) at 320 mm (front), 100 mm (side) or less to 0 (black) at 480 mm" in greys


@pytest.mark.parametrize(
    ("where", "change", "phrase"),
    [
        ("task", {"needle_radius": 0.021}, "21 mm"),
        ("task", {"needle_yaw": 0.733 + np.pi}, "the one that is farther from the hoop"),
        ("episode", {"control": "pose"}, "about each of them"),
        ("episode", {"lift_radius": 0.0123}, "within 12.3 mm of lift_position"),
    ],
)
def test_numbers_come_from_the_settings(settings, where, change, phrase):
    changed = replace(settings, **{where: replace(getattr(settings, where), **change)})

    def scene(s: Settings) -> str:
        return description.scene(s) + description.signals(s)

    assert phrase in scene(changed)
    assert phrase not in scene(settings)


def test_what_the_text_says_of_frames_is_so_in_the_scene(settings):
    """At the start of many episodes, and while the expert carries the needle."""
    s = replace(settings, num_envs=32, cams=(), reward=NONE)
    simulation = build(s)
    act = Expert(s.task, s.episode)
    moment = simulation.reset()
    start = moment.signals
    tail = centre_line(s.task, start.pickup_point, start.needle_quat)[:, 0]
    nearer = geo.distance(start.needle_tip, start.goal) < geo.distance(tail, start.goal)
    assert bool(nearer.all()) == sharp_end_is_nearer(s.task)
    for _ in range(40):
        now = moment.signals
        to_tips = geo.rotate(geo.conjugate(now.tool_quat), now.tool_midpoint - now.wrist_pos)
        assert bool((to_tips[:, 2] > 0.9 * s.task.grip).all())
        moment = simulation.step(act(now))


def leaks(text: str, settings: Settings) -> list[str]:
    """What a text says of the human reward and of the success test."""
    lowered = text.lower()
    words = {"touched", "touching", "threaded", "threading", "verdict", "cheat", "human"}
    words |= {"success", "succeeds", "beyond the", "radius of the goal", "goal's radius"}
    words |= {f.name for f in fields(Human)} | {f.name for f in fields(settings.episode)}
    # Plain words that the task can't be told without.
    words -= {"grasp", "lift", "hoop", "closed", "time", "rate", "reach", "unit", "jaw", "rotation"}
    words -= {"control", "translation"}
    hits = [name for name in sorted(words) if re.search(rf"\b{name}\b", lowered)]
    lines = [line.strip().lower() for line in inspect.getsource(Human.__call__).splitlines()[2:]]
    hits += [line for line in lines if len(line) >= 4 and line in lowered]
    episode, reward = settings.episode, settings.reward
    # When the needle is held and lifted is what signals mean; when the task is done is not told.
    near = [episode.goal_radius, episode.thread_depth]
    limits = [*near]
    unit = reward["unit"]
    limits += [reward["tolerance"] * unit, reward["rate"] / unit, reward["closed_below"]]
    values = [f"{1000 * value:g} mm" for value in near] + [str(value) for value in limits]
    values += [str(float(reward[name])) for name in ("grasp", "lift", "hoop", "closed")]
    return hits + [v for v in values if re.search(rf"(?<![\d.]){re.escape(v)}(?!\d)", lowered)]


def test_neither_the_human_reward_nor_the_success_test_is_told(requests, corrected, settings):
    prompts = text_of([*requests, *corrected])
    # Measured numbers may be any.
    rest = re.sub(r"^name +shape +unit +frame +least(.|\n)*?\n\n", "", prompts, flags=re.MULTILINE)
    assert leaks(rest, settings) == []
    # What leaked would be found.
    source = inspect.getsource(Human.__call__).splitlines()
    for leak in (
        *("it is done once threaded", "when the tip is within 5 mm", "distance < 0.005"),
        *("a term closed_below", "reward 3.0 for the lift", f"    {source[3]}"),
    ):
        assert leaks(f"{rest}\n{leak}", settings), leak


def test_refused_programs_go_back_with_every_kind_of_reason(corrected):
    prompts = text_of(corrected[-1:])
    for reason in (
        *("Import is not in the language", "above a random policy", "rises to 40.000"),
        *("not finite on", "an episode that fails at the task ends"),
    ):
        assert reason in prompts


def test_all_prompts_are_among_those_searched(requests, corrected):
    prompts = " ".join(text_of([*requests, *corrected]).split())
    for name, text in description.texts(TASK).items():
        longest = max(re.split(r"\$[a-z_]+", text), key=len)
        assert len(longest) > 20
        assert " ".join(longest.split()) in prompts, name


def test_nothing_said_depends_on_rewards_or_on_what_success_is(requests, settings, tmp_path):
    odd = replace(
        settings,
        reward={**settings.reward, "grasp": 7.123, "tolerance": 0.0777, "closed_below": 0.0555},
        episode=replace(
            settings.episode, goal_radius=0.00456, thread_depth=0.00789, end_on_success=False
        ),
    )
    other = everything_said(odd, tmp_path)
    assert [request.sha256 for request in other] == [request.sha256 for request in requests]
