"""The shipped recordings: whole, in step with themselves, and of use."""

from __future__ import annotations

import csv
import hashlib
import json
from typing import Any

import pytest

from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.rewards.program_reward import find
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF, RECORDINGS
from needlehoop.training import session
from needlehoop.vlm.config import transcripts
from needlehoop.vlm.conversation import totals_of
from needlehoop.vlm.messages import Request
from needlehoop.vlm.record import Exchange, Record
from needlehoop.vlm.writing import ProgramRules

CLAUDE = RECORDINGS / "claude"
RESULTS = CONF.parent / "results/rewards"
PLACEMENTS = "claude_placements"
ROOM = "claude_operating_room"
RECIPE = "claude_recipe"
VIEWS = ("wrist", "ecm_left", "ecm_left+{r}_ecm_right", "ecm_left+{r}_wrist", "front+{r}_wrist")
"""The sets of ``ROOM``, in each rendering; and ``front+side``."""
TASKS = {
    "claude": "needle_hoop",
    "claude_peg_transfer": "peg_transfer",
    ROOM: "needle_hoop",
    PLACEMENTS: "needle_hoop",
    "claude_reach": "reach",
    RECIPE: "needle_hoop",
}
PROGRAMS = {"claude": (5, 5), "claude_peg_transfer": (3, 3), RECIPE: (0, 20)}
"""From text, and from text and images."""
PAIR = "dep_front+seg_side"


@pytest.fixture(scope="module")
def transcript() -> Record:
    return Record(CLAUDE)


def is_of_the_former_grasp(exchange: Exchange) -> bool:
    """Whether it asked for a program and told that jaws that touch the thing have grasped it."""
    return "becomes true when both jaws touch" in json.dumps(exchange.request)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.full] if name in PROGRAMS else []) for name in TASKS],
)
def test_every_conversation_is_replayed_with_the_prompts_of_today(name, elsewhere, monkeypatch):
    """A changed prompt, picture or judge of programs fails here until it is asked anew."""
    recorded = Record(RECORDINGS / name)
    hashes: list[str] = []
    answer = Record.ask

    def ask(self: Record, request: Request, conversation: str) -> Exchange:
        exchange = answer(self, request, conversation)
        assert exchange.conversation == conversation
        hashes.append(exchange.sha256)
        return exchange

    monkeypatch.setattr(Record, "ask", ask)
    # Both flavours are judged by the same trajectories.
    rules: list[ProgramRules] = []

    def rules_of(values: dict[str, Any]) -> ProgramRules:
        if not rules:
            rules.append(made_rules(values))
        return rules[0]

    made_rules = session.rules_of
    monkeypatch.setattr(session, "rules_of", rules_of)
    words = [f"task={TASKS[name]}", f"vlm.recording={name}", "engine.threads=1"]
    words = words[1:] if TASKS[name] == "needle_hoop" else words
    needle = (
        ["samples=3"],
        ["afresh=true"],
        ["vlm.prompt_detail=names"],
        ["vlm.prompt_detail=nothing"],
    )
    sets = [
        [f"{r}_{view.format(r=r)}" for view in (*VIEWS, "front+{r}_side")]
        for r in ("rgb", "seg", "dep")
    ]
    lists = ",".join(f"[{','.join(cameras)}]" for cameras in sets)
    commands = {
        "claude": needle,
        PLACEMENTS: (["+experiment=placements", "study=main"],),
        ROOM: ([f"sets=[{lists}]", "task=wide", "group=6"],),
        RECIPE: (),
    }
    for arguments in commands.get(name, ([],)):
        assert main(["vlm", "rank", *arguments, *words]) == 0
    if name == "claude":
        for detail, flavour in (("names", "text"), ("nothing", "image")):
            arguments = [f"vlm.prompt_detail={detail}", f"flavour={flavour}", f"study={detail}"]
            assert main(["vlm", "reward", *arguments, "cams=[dep_front,seg_side]"]) == 0
    if name == RECIPE:
        arguments = ["cams=[dep_front,seg_side]", "flavour=image", "samples=20", "task=wide"]
        assert main(["vlm", "reward", *arguments, *words]) == 0
    today = [one.sha256 for one in recorded.exchanges if not is_of_the_former_grasp(one)]
    assert sorted(hashes) == sorted(today)
    for file in RECORDINGS.glob(f"{name}/[qra]*.*"):
        made = elsewhere / "results/main/vlm" / file.name
        assert made.name == "README.md" or made.read_text() == file.read_text()


def test_without_a_name_the_recording_answers(elsewhere, capsys):
    assert transcripts() == {name: RECORDINGS / name for name in TASKS}
    assert main(["vlm", "question"]) == 0
    assert "Best placement of one camera: " in capsys.readouterr().out


def test_requests_are_what_their_hashes_say_and_their_pictures_are_there(transcript):
    assert len(transcript.exchanges) == 52
    shown = set()
    for exchange in transcript.exchanges:
        text = json.dumps(
            exchange.request, sort_keys=True, separators=(",", ":"), ensure_ascii=False
        )
        assert hashlib.sha256(text.encode()).hexdigest() == exchange.sha256
        parts = [part for m in exchange.request["messages"] for part in m["parts"]]
        shown |= {part["image"] for part in parts if "image" in part}
    index = json.loads((CLAUDE / "pictures.json").read_text())["pictures"]
    kept = {name for states in index.values() for name in states.values()}
    assert shown <= kept
    for name in kept:
        assert transcript.picture(name).png.startswith(b"\x89PNG")


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_are_those_that_were_answered(name):
    """The last answer of each conversation, after any that were refused."""
    answers = {
        exchange.conversation: json.loads(exchange.answer)["program"]
        for exchange in Record(RECORDINGS / name).exchanges
        if exchange.conversation.startswith("reward/")
        and not exchange.conversation.endswith(("/names", "/nothing"))
    }
    files = {}
    for (place, flavour), count in zip(
        (("reward/text", "any/text"), (f"reward/{PAIR}/image", f"{PAIR}/image")),
        PROGRAMS[name],
        strict=True,
    ):
        files |= {place: f"{flavour}.txt"} if count else {}
        files |= {f"{place}/{n}": f"{flavour}_{n}.txt" for n in range(2, count + 1)}
    assert set(answers) == set(files)
    for conversation, file in files.items():
        program = (RECORDINGS / name / "rewards" / file).read_text()
        assert program.strip() == answers[conversation].strip()


def test_totals_are_of_the_transcript(transcript):
    with (CLAUDE / "totals.csv").open(newline="") as file:
        rows = {row.pop("conversation"): row for row in csv.DictReader(file)}
    totals = totals_of(transcript.exchanges)
    assert rows == {name: {k: str(v) for k, v in row.items()} for name, row in totals.items()}


def test_what_was_trained_on_stays_what_it_was():
    for kind, flavour in (("vlm_img_claude", "image"), ("vlm_text_claude", "text")):
        config = read_yaml(RESULTS / f"{PAIR}/{kind}/seed0/config.yaml")["reward"]
        reward = composing.compose([f"reward={kind}", "cams=[dep_front,seg_side]"], "config")
        recording = reward["reward"]["recording"]
        source = find(["dep_front", "seg_side"], flavour, None, "results", recording)
        assert source.text == config["program"]["text"]
