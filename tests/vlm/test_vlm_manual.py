"""``vlm=manual``: questions in folders, answered by hand, or here by another process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from vlm_server import by_schema

from needlehoop.cli.main import main
from needlehoop.training import session
from needlehoop.vlm.conversation import Verdict
from needlehoop.vlm.messages import Message, Png, Request
from needlehoop.vlm.providers.manual import find_json, write_request
from needlehoop.vlm.writing import ProgramRules

VLM = Path("results/main/vlm")
WORDS = ["vlm=manual", "vlm.model=somebody", "vlm.poll=0.02", "size=16"]
AT_ONCE = [*WORDS, "vlm.wait=0"]
CAMS = "cams=[dep_front,seg_side]"
GOOD = json.dumps({"explanation": "e", "program": "reward = 9 if grasped else 0"})


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rules = ProgramRules(0.0, 9.0, judge)
    monkeypatch.setattr(session, "rules_of", lambda _: rules)


def judge(source: str) -> Verdict:
    refused = "import" in source
    return Verdict("line 1: import is not allowed" if refused else None, {"ok": True})


@contextmanager
def somebody_answers() -> Iterator[None]:
    """A process that does."""
    person = Path(__file__).parents[1] / "vlm_person.py"
    process = subprocess.Popen([sys.executable, str(person), str(VLM)])
    try:
        yield
    finally:
        VLM.mkdir(parents=True, exist_ok=True)
        (VLM / "enough").touch()
        assert process.wait(10) == 0


def question() -> Path:
    """The folder of the one question that waits."""
    (found,) = (VLM / "asked").iterdir()
    return found


def lines() -> list[dict]:
    return [json.loads(line) for line in (VLM / "transcript.jsonl").read_text().splitlines()]


def test_a_process_answers_a_questioning_and_two_rankings(capsys):
    own = "lists=[[rgb_default,dep_front+seg_side]]"
    with somebody_answers():
        assert main(["vlm", "rank", *WORDS, own, "samples=2"]) == 0
    exchanges = lines()
    assert len(exchanges) == 2 * 8
    assert {e["answered_by"] for e in exchanges} == {"somebody"}
    assert {e["provider"] for e in exchanges} == {"manual"}
    assert {tuple(e["attempts"]) for e in exchanges} == {("by hand",)}
    assert all(isinstance(json.loads(e["answer"]), dict) for e in exchanges)
    # The second sample's first question is the first one's again: a folder of its own.
    first, again = exchanges[0], exchanges[8]
    assert first["sha256"] == again["sha256"]
    done = sorted(path.name for path in (VLM / "answered").iterdir())
    assert [name.partition("_")[0] for name in done] == [f"{i:03d}" for i in range(1, 17)]
    assert [n.partition("_")[2] for n in done] == [e["sha256"][:16] for e in exchanges]
    assert list((VLM / "asked").iterdir()) == []
    told = [line for line in capsys.readouterr().err.splitlines() if "vlm=manual" in line]
    assert told
    assert "request.md and its pictures to somebody" in told[0]
    # And without anybody, from the record.
    assert main(["vlm", "rank", "size=16", own, "samples=2"]) == 0


def test_what_is_asked_can_be_read_and_its_pictures_found():
    assert main(["vlm", "question", *AT_ONCE]) == 2
    place = question()
    text = (place / "request.md").read_text()
    named = [line[9:15] for line in text.splitlines() if line.startswith("[picture ")]
    assert named == [f"{i:02d}.png" for i in range(1, 13)]
    assert sorted(path.name for path in place.glob("*.png")) == named
    assert "rgb_side, start:\n\n[picture 03.png]" in text
    assert "rgb_side, goal:\n\n[picture 12.png]" in text
    schema = json.loads((place / "schema.json").read_text())
    assert json.dumps(schema, indent=2) in text
    assert "What was said before" not in text


def test_a_request_carries_what_was_said_and_numbers_all_pictures(tmp_path):
    one, two = Png(b"1"), Png(b"2")
    messages = (
        Message("user", ("See:", one)),
        Message("assistant", ("Seen.",)),
        Message("user", ("And this:", two, "?")),
    )
    write_request(Request(messages, {"type": "object"}), tmp_path)
    text = (tmp_path / "request.md").read_text()
    before, _, now = text.partition("# What is asked now")
    assert "See:\n\n[picture 01.png]" in before
    assert "## The model answered\n\nSeen." in before
    assert "And this:\n\n[picture 02.png]\n\n?" in now
    assert (tmp_path / "02.png").read_bytes() == b"2"


def test_it_stops_and_goes_on(capsys):
    assert main(["vlm", "question", *AT_ONCE]) == 2
    assert "no answer yet; put it there, and the same command goes on" in capsys.readouterr().err
    # Nothing is recorded of a question that nobody answered.
    assert not (VLM / "transcript.jsonl").exists()
    first = question()
    written = (first / "request.md").stat().st_mtime_ns
    assert main(["vlm", "question", *AT_ONCE]) == 2
    assert question() == first
    assert (first / "request.md").stat().st_mtime_ns == written
    (first / "answer.json").write_text(by_schema(json.loads((first / "schema.json").read_text())))
    assert main(["vlm", "question", *AT_ONCE]) == 2
    assert len(lines()) == 1
    assert (VLM / "answered" / f"001_{first.name}" / "answer.json").exists()
    assert question() != first
    assert "# What was said before" in (question() / "request.md").read_text()


def test_ctrl_c_is_no_failure(monkeypatch, capsys):
    def stop(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", stop)
    assert main(["vlm", "question", *WORDS]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == (
        "needlehoop vlm question: stopped; the same command goes on"
    )
    assert (question() / "request.md").exists()


def test_an_answer_in_the_wrong_form_goes_back_like_any_other():
    assert main(["vlm", "reward", *AT_ONCE, CAMS]) == 2
    (question() / "answer.md").write_text("I would rather not say.")
    assert main(["vlm", "reward", *AT_ONCE, CAMS]) == 2
    correction = (question() / "request.md").read_text()
    assert "That answer could not be used" in correction
    assert "I would rather not say." in correction
    bad = json.dumps({"explanation": "e", "program": "import os"})
    (question() / "answer.json").write_text(bad)
    assert main(["vlm", "reward", *AT_ONCE, CAMS]) == 2
    assert "import is not allowed" in (question() / "request.md").read_text()
    (question() / "answer.txt").write_text(f"Here:\n```\n{GOOD}\n```")
    assert main(["vlm", "reward", *AT_ONCE, CAMS]) == 0
    program = VLM / "rewards/dep_front+seg_side/image.txt"
    assert program.read_text() == "reward = 9 if grasped else 0\n"
    assert [line["answer"] for line in lines()][-1] == GOOD


def test_an_answer_too_deep_or_too_long_for_json_goes_back_like_any_other():
    bad = (
        "[" * 200_000,
        '{"a": ' * 50_000 + "1" + "}" * 50_000,
        f'{{"explanation": {"9" * 6_000}}}',
    )
    assert main(["vlm", "reward", *AT_ONCE, CAMS, "attempts=4"]) == 2
    for number, said in enumerate(bad, 1):
        (question() / "answer.json").write_text(said)
        assert main(["vlm", "reward", *AT_ONCE, CAMS, "attempts=4"]) == 2
        assert [line["answer"] for line in lines()] == list(bad[:number])
        assert "That answer could not be used" in (question() / "request.md").read_text()
    (question() / "answer.json").write_text(GOOD)
    assert main(["vlm", "reward", *AT_ONCE, CAMS, "attempts=4"]) == 0


def test_an_answer_that_is_no_text_is_named_and_an_empty_one_waited_out(capsys):
    assert main(["vlm", "question", *AT_ONCE]) == 2
    (question() / "answer.json").write_bytes(b"\xff\xfe{")
    assert main(["vlm", "question", *AT_ONCE]) == 2
    assert "answer.json: no UTF-8 text" in capsys.readouterr().err
    (question() / "answer.json").write_text("\n")
    assert main(["vlm", "question", *AT_ONCE]) == 2
    assert not (VLM / "transcript.jsonl").exists()


def test_json_is_found_in_what_was_pasted():
    for said in (
        '{"a": 1}',
        'Sure!\n```json\n{"a": 1}\n```\nThat is it.',
        'First I thought of\n```json\n{"b": 2}\n```\nbut\n```json\n{"a": 1}\n```',
        'It is {"a": 1}, I think.',
        '```python\nx = {}\n```\n```json\n{"a": 1}\n```',
    ):
        assert json.loads(find_json(said)) == {"a": 1}
    for said in ("nothing", "```json\n{]\n```", "[1, 2]"):
        assert find_json(said) == said


def test_a_mistake_is_one_line(capsys):
    for words, said in (
        (["vlm=manual"], "vlm.model"),
        (["vlm=manual", "vlm.model=' '"], "vlm.model: say who answers"),
        ([*WORDS, "vlm.poll=0"], "vlm.poll: 0.0 must be positive"),
        ([*WORDS, "vlm.wait=-1"], "vlm.wait: -1.0 is negative"),
        ([*WORDS, "vlm.kind=postcard"], "choose from replay, gemini, openai, manual"),
    ):
        assert main(["vlm", "question", *words]) == 2
        assert said in capsys.readouterr().err
    assert not Path("results").exists()
