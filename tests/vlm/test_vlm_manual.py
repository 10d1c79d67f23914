"""``vlm=manual``: questions in folders, answered by hand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from vlm_server import by_schema

from needlehoop.cli.main import main
from needlehoop.training import session
from needlehoop.vlm.conversation import Verdict
from needlehoop.vlm.messages import Message, Png, Request
from needlehoop.vlm.providers import find_json, write_request
from needlehoop.vlm.writing import ProgramRules

pytestmark = pytest.mark.usefixtures("elsewhere")

VLM = Path("results/main/vlm")
WORDS = ["vlm=manual", "vlm.model=somebody", "vlm.poll=0.001", "size=16"]
AT_ONCE = [*WORDS, "vlm.wait=0"]
GOOD = json.dumps({"explanation": "e", "program": "reward = 9 if grasped else 0"})


def question() -> Path:
    """The folder of the one question that waits."""
    (folder,) = (VLM / "asked").iterdir()
    return folder


def lines() -> list[dict]:
    return [json.loads(line) for line in (VLM / "transcript.jsonl").read_text().splitlines()]


def test_the_same_command_goes_on_until_all_is_answered(capsys):
    lists = "lists=[[rgb_default,dep_front+seg_side]]"
    rank = ["vlm", "rank", lists, "afresh=true", "samples=3"]
    folders = []
    while main([*rank, *AT_ONCE]) != 0:
        folder = question()
        text = by_schema(json.loads((folder / "schema.json").read_text()))
        name, text = ("answer.md", f"```\n{text}\n```\n") if folders else ("answer.json", text)
        (folder / name).write_text(text)
        folders.append(folder.name)
    exchanges = lines()
    assert [e["sha256"][:16] for e in exchanges] == folders
    assert {(e["provider"], e["answered_by"]) for e in exchanges} == {("manual", "somebody")}
    # Each sample asks the same: a folder of its own.
    assert len(exchanges) == 3
    assert len({e["sha256"] for e in exchanges}) == 1
    done = sorted(path.name for path in (VLM / "answered").iterdir())
    assert done == [f"{i:03d}_{name}" for i, name in enumerate(folders, 1)]
    assert list((VLM / "asked").iterdir()) == []
    error = capsys.readouterr().err
    assert "request.md and its pictures to somebody" in error
    assert "no answer yet; put it there, and the same command goes on" in error
    # And without anybody, from the record.
    assert main([*rank, "size=16"]) == 0


def test_a_request_carries_what_was_said_and_numbers_all_pictures(tmp_path):
    messages = (
        Message("user", ("See:", Png(b"1"))),
        Message("assistant", ("Seen.",)),
        Message("user", ("And this:", Png(b"2"), "?")),
    )
    write_request(Request(messages, {"type": "object"}), tmp_path)
    before, _, now = (tmp_path / "request.md").read_text().partition("# What is asked now")
    assert "See:\n\n[picture 01.png]" in before
    assert "## The model answered\n\nSeen." in before
    assert "And this:\n\n[picture 02.png]\n\n?" in now
    assert (tmp_path / "02.png").read_bytes() == b"2"
    assert json.loads((tmp_path / "schema.json").read_text()) == {"type": "object"}
    write_request(Request(messages[:1], {"type": "object"}), tmp_path)
    assert "What was said before" not in (tmp_path / "request.md").read_text()


def test_an_answer_in_the_wrong_form_goes_back_like_any_other(monkeypatch):
    rules = ProgramRules(0.0, 9.0, lambda _: Verdict(None))
    monkeypatch.setattr(session, "rules_of", lambda _: rules)
    reward = ["vlm", "reward", *AT_ONCE, "cams=[dep_front,seg_side]"]
    assert main(reward) == 2
    # Nothing is recorded of a question that nobody answered.
    assert not (VLM / "transcript.jsonl").exists()
    (question() / "answer.md").write_text("I would rather not say.")
    assert main(reward) == 2
    correction = (question() / "request.md").read_text()
    assert "That answer could not be used" in correction
    assert "I would rather not say." in correction
    (question() / "answer.txt").write_text(f"Here:\n```\n{GOOD}\n```")
    assert main(reward) == 0
    program = VLM / "rewards/dep_front+seg_side/image.txt"
    assert program.read_text() == "reward = 9 if grasped else 0\n"
    assert [line["answer"] for line in lines()][-1] == GOOD


def test_json_is_found_in_what_was_pasted():
    for answer in (
        'Sure!\n```json\n{"a": 1}\n```\nThat is it.',
        'First I thought of\n```json\n{"b": 2}\n```\nbut\n```json\n{"a": 1}\n```',
        'It is {"a": 1}, I think.',
    ):
        assert json.loads(find_json(answer)) == {"a": 1}
    assert find_json("[1, 2]") == "[1, 2]"
