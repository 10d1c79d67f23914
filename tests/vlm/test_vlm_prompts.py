"""What a model is told, and what it must not be."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterable
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import pytest
from vlm_server import by_schema

from needlehoop import config
from needlehoop.envs.settings import Settings
from needlehoop.rewards.human import Human
from needlehoop.scene import vocabulary
from needlehoop.vlm import description, prompts
from needlehoop.vlm.album import STATES, Album
from needlehoop.vlm.conversation import Conversation, NoAnswerError
from needlehoop.vlm.forms import Program
from needlehoop.vlm.gates import Gates
from needlehoop.vlm.messages import Picture, Request
from needlehoop.vlm.prompts import fill
from needlehoop.vlm.providers.contract import LiveConfig, Reply
from needlehoop.vlm.questions import Questions, question
from needlehoop.vlm.ranking import Lists, rank
from needlehoop.vlm.recorder import Recorder
from needlehoop.vlm.transcript import Transcript
from needlehoop.vlm.workshop import open_workshop
from needlehoop.vlm.writing import Verdict, Work, Workshop, reward_prompt, write_program

QUESTIONS = Questions(("rgb", "dep", "seg"), {"one": "one camera", "two": "two cameras"})
LISTS = Lists((("rgb_default", "dep_front+seg_side"),), 1)
FUNCTIONS = {"distance": ("distance(a, b)", "between two points")}
WORKSHOP = Workshop(FUNCTIONS, "It ends with reward.", 0.0, 9.0, lambda _: Verdict(True, "", {}))
CONFIG = LiveConfig("gemini", "m", None, None, {}, 1.0, 1, 0.0, 0.0)


class Obliging:
    """Answers as told, then anything in the right form; ranks in the order of the list."""

    def __init__(self, answers: Iterable[str] = ()):
        self.answers = list(answers)
        self.asked: list[Request] = []

    def ask(self, request: Request) -> Reply:
        self.asked.append(request)
        answer = self.answers.pop(0) if self.answers else by_schema(dict(request.schema))
        return Reply("answered", answer, "", "m", 1, 1)

    def close(self) -> None:
        pass


def album(settings: Settings) -> Album:
    names = [f"{r}_{view}" for r in settings.renderings for view in settings.views]
    return Album({s: {n: Picture(f"{s} {n}".encode()) for n in names} for s in STATES})


def everything_said(settings: Settings, folder: Path) -> list[Request]:
    """All requests of a questioning, a ranking and both kinds of reward."""
    provider = Obliging()
    recorder = Recorder(Transcript(folder), provider, CONFIG)

    def begin(_: int) -> Conversation:
        conversation = Conversation(recorder, "question", 1)
        question(conversation, settings, album(settings), QUESTIONS)
        return conversation

    rank(begin, LISTS)
    seen = replace(settings, cams=("dep_front", "seg_side"))
    for flavour in ("text", "image"):
        parts = reward_prompt(seen, WORKSHOP, flavour, album(seen))
        Conversation(recorder, "reward", 1).ask(parts, Program)
    return provider.asked


def text_of(requests: list[Request]) -> str:
    return "\n".join(
        part
        for request in requests
        for message in request.messages
        for part in message.parts
        if isinstance(part, str)
    )


@pytest.fixture(scope="module")
def asked(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> list[Request]:
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
    gates = config.as_type(config.compose([], "check")["gates"], Gates, "gates")
    # The default margin of the audit is also the angle at which the jaws let go.
    gates = replace(gates, episodes=1, random_signals=50, audit="refuse", audit_margin=0.75)
    quick = replace(settings, engine=replace(settings.engine, threads=1))
    workshop = open_workshop(quick, gates)
    programs = [json.dumps({"explanation": "e", "program": program}) for program in BAD]
    provider = Obliging(programs)
    recorder = Recorder(Transcript(tmp_path_factory.mktemp("bad")), provider, CONFIG)
    work = Work(Conversation(recorder, "reward", len(BAD)))
    with pytest.raises(NoAnswerError):
        write_program(work, reward_prompt(settings, workshop, "text"), workshop)
    return provider.asked


def test_one_conversation_shows_three_pictures_then_eighteen(asked):
    counts = [sum(isinstance(p, Picture) for p in r.messages[-1].parts) for r in asked]
    # Five questions, one list, a reward from text and one from text and pictures.
    assert counts == [3, 18, 0, 0, 0, 0, 0, 2]
    for before, after in pairwise(asked[:6]):
        assert after.messages[: len(before.messages)] == before.messages
    assert all(len(request.messages) == 1 for request in asked[6:])


def test_pictures_come_after_a_line_that_names_them(asked, settings):
    parts = asked[1].messages[-1].parts
    at = parts.index("dep_side, goal:")
    assert parts[at + 1] == Picture(b"goal dep_side")
    assert asked[0].messages[0].parts[-2:] == ("rgb_side, start:", Picture(b"start rgb_side"))
    assert asked[7].messages[0].parts[-4::2] == ("dep_front, start:", "seg_side, start:")


def test_the_text_says_what_the_scene_and_the_signals_are(asked, settings):
    said = text_of(asked[:1])
    for value in ("18 mm", "145 degrees", "3.8 mm", "9 mm", "36 mm"):
        assert value in said
    for view in settings.views:
        assert f"- {view}: " in said
    reward = text_of(asked[6:7])
    assert vocabulary.describe() in reward
    assert "distance(a, b): between two points" in reward
    assert "between 0 and 9" in reward
    changed = replace(settings, task=replace(settings.task, needle_radius=0.021))
    assert "21 mm" in description.scene(changed)


def leaks(text: str, settings: Settings) -> list[str]:
    """What a text says of the human reward and of the success test."""
    said = text.lower()
    words = {"touched", "touching", "threaded", "threading", "verdict", "cheat", "human"}
    words |= {f.name for f in fields(Human)} | {f.name for f in fields(settings.episode)}
    # Plain words that the task can't be told without.
    words -= {"grasp", "lift", "hoop", "closed", "time", "rate", "reach", "jaw", "rotation"}
    words -= {"control", "translation"}
    found = [name for name in sorted(words) if re.search(rf"\b{name}\b", said)]
    lines = [line.strip().lower() for line in inspect.getsource(Human.__call__).splitlines()[2:]]
    found += [line for line in lines if len(line) >= 4 and line in said]
    episode, reward = settings.episode, settings.reward
    near = [episode.lift_radius, episode.goal_radius, episode.thread_depth]
    limits = [*near, episode.close_below, episode.release_above]
    limits += [float(reward[name]) for name in ("tolerance", "rate", "closed_below")]
    values = [f"{1000 * value:g} mm" for value in near] + [str(value) for value in limits]
    values += [str(float(reward[name])) for name in ("grasp", "lift", "hoop", "closed")]
    return found + [v for v in values if re.search(rf"(?<![\d.]){re.escape(v)}(?!\d)", said)]


def test_neither_the_human_reward_nor_the_success_test_is_told(asked, corrected, settings):
    assert leaks(text_of([*asked, *corrected]), settings) == []


def test_all_prompts_are_among_those_searched(asked, corrected):
    said = " ".join(text_of([*asked, *corrected]).split())
    for path in Path(prompts.__file__).parent.glob("*.txt"):
        longest = max(re.split(r"\$[a-z_]+", path.read_text()), key=len)
        assert len(longest) > 20
        assert " ".join(longest.split()) in said, path


@pytest.mark.parametrize(
    "leak",
    [
        "it is done once threaded",
        "touching the goal",
        "when the tip is within 5 mm",
        "distance < 0.005",
        "exp(-80.0 * d)",
        "a term closed_below",
        "reward 3.0 for the lift",
        *(f"    {line}" for line in inspect.getsource(Human.__call__).splitlines()[3:5]),
    ],
)
def test_what_leaked_would_be_found(asked, settings, leak):
    assert leaks(f"{text_of(asked)}\n{leak}", settings)


def test_refused_programs_go_back_with_every_kind_of_reason(corrected):
    said = text_of(corrected[-1:])
    for reason in ("'import' is not in the language", "above a random policy", "rises to 40.000"):
        assert reason in said
    assert "not finite on" in said
    assert "an episode that fails at the task ends" in said


def test_nothing_said_depends_on_rewards_or_thresholds(asked, settings, tmp_path):
    odd = replace(
        settings,
        reward={**settings.reward, "grasp": 7.123, "tolerance": 0.0777, "closed_below": 0.0555},
        episode=replace(
            settings.episode,
            lift_radius=0.0123,
            goal_radius=0.00456,
            thread_depth=0.00789,
            close_below=0.321,
            release_above=0.654,
        ),
    )
    other = everything_said(odd, tmp_path)
    assert [request.sha256 for request in other] == [request.sha256 for request in asked]


def test_gaps_and_values_of_a_prompt_must_agree():
    assert "because" in fill("again", reason="because")
    with pytest.raises(ValueError, match="prompt again: reason missing"):
        fill("again")
    with pytest.raises(ValueError, match="prompt again: more missing or not asked for"):
        fill("again", reason="", more="")


def test_every_prompt_is_used(settings):
    folder = Path(prompts.__file__).parent
    source = "".join(path.read_text() for path in folder.parent.glob("*.py"))
    for path in folder.glob("*.txt"):
        assert f'"{path.stem}"' in source, path


def test_lists_and_questions_that_make_no_sense(settings):
    for make, said in [
        (lambda: Questions(("rgb",), {"a": "", "b": ""}), "shown"),
        (lambda: Questions(("rgb", "dep"), {"a": ""}), "layouts"),
        (lambda: Questions(("rgb", "xray"), {"a": "", "b": ""}).check(settings), "'xray'"),
        (lambda: Lists((), 1), "nothing to rank"),
        (lambda: Lists((("a",),), 1), "two or more"),
        (lambda: Lists((("a", "b"),), 0), "samples: 0"),
        (lambda: Lists((("rgb_top", "b"),), 1).check(settings, ["rgb"]), "lists: rgb_top"),
        (lambda: Lists((("seg_side", "b"),), 1).check(settings, ["rgb"]), "choose from rgb"),
    ]:
        with pytest.raises(ValueError, match=re.escape(said)):
            make()


def test_renderings_in_words(settings):
    kinds = settings.renderings
    assert "shades of grey" in description.rendering(kinds["dep"])
    assert "needle (255, 230, 0)" in description.rendering(kinds["seg"])
    assert "darker with distance" in description.rendering(kinds["segdep"])
    alone = replace(kinds["dep"], colour="none")
    assert "agent is given" not in description.rendering(alone)
    assert json.dumps(description.view(settings.views["default"])).count("45") == 1
