"""Records, replay, conversations, forms: with a model made of a list of replies."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from needlehoop.vlm.conversation import (
    Conversation,
    NoAnswerError,
    Subtasks,
    in_words,
    ranking,
    totals_of,
)
from needlehoop.vlm.messages import Message, Png, ProviderError, Reply, Request
from needlehoop.vlm.record import MissError, Record, RefusalError

PICTURE = Png(b"a picture")
DOWN = ProviderError("down", 503)


def reply(answer: str, outcome: str = "answered", detail: str = "") -> Reply:
    return Reply(outcome, answer, detail, "answered-by", 10, 3, ("timeout", 200))


class Scripted:
    """A provider that gives what it is told to."""

    def __init__(self, *script: Reply | ProviderError, temperature: float = 2.0):
        self.script, sampling = list(script), {"temperature": temperature}
        self.who = {"provider": "gemini", "model": "asked-for", "sampling": sampling}
        self.requests: list[Request] = []

    def ask(self, request: Request) -> Reply:
        self.requests.append(request)
        entry = self.script.pop(0)
        if isinstance(entry, ProviderError):
            raise entry
        return entry


def live(folder: Path, *script: Reply | ProviderError) -> Record:
    return Record(folder, Scripted(*script))


def request(text: str) -> Request:
    return Request((Message("user", (text, PICTURE)),), {"type": "object"})


def test_the_hash_of_a_request_is_golden():
    messages = (
        Message("user", ("Größe?", Png(b"png"))),
        Message("assistant", ("12",)),
        Message("user", ("Sure?",)),
    )
    question = Request(messages, {"type": "object", "b": 1, "a": [2.5]})
    assert question.sha256 == "c0533a0cf76d60ec257848db546dddf566c3f96966ae6da0dc21f87deb436f58"
    assert question.sha256 == Request(messages, {"a": [2.5], "b": 1, "type": "object"}).sha256


def test_repeats_replay_in_order_and_then_run_out(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    again = live(tmp_path, reply("2"), reply("3"))
    # The record's own answer comes first: nothing is paid for twice.
    assert [again.ask(request("a"), "rank/2").answer for _ in range(3)] == ["1", "2", "3"]
    record = Record(tmp_path)
    assert [record.ask(request("a"), "rank").answer for _ in range(3)] == ["1", "2", "3"]
    with pytest.raises(MissError, match="answered 3 times, and they are used up"):
        record.ask(request("a"), "rank")
    with pytest.raises(MissError, match="no recorded request is this one"):
        record.ask(request("b"), "rank")


def test_a_refusal_or_a_failure_is_recorded_replayed_and_asked_again(tmp_path):
    with pytest.raises(RefusalError, match=r"refused to answer: SAFETY"):
        live(tmp_path, reply("", "refused", "SAFETY")).ask(request("a"), "question")
    with pytest.raises(RefusalError, match=r"refused to answer: SAFETY"):
        Record(tmp_path).ask(request("a"), "question")
    assert live(tmp_path, reply("well")).ask(request("a"), "question").answer == "well"
    assert Record(tmp_path).ask(request("a"), "question").answer == "well"
    with pytest.raises(ProviderError, match="down"):
        live(tmp_path, DOWN).ask(request("b"), "question")
    last = Record(tmp_path).exchanges[-1]
    assert (last.outcome, last.attempts) == ("failed", (503,))
    with pytest.raises(MissError):
        Record(tmp_path).ask(request("b"), "question")


def test_a_transcript_is_of_one_model_and_sampling_and_whole(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    with pytest.raises(ValueError, match="choose another study="):
        Record(tmp_path, Scripted(temperature=1.0))
    path = tmp_path / "transcript.jsonl"
    path.write_text(path.read_text() + '{"sha256": "be')
    with pytest.raises(ValueError, match="line 2 is no exchange"):
        Record(tmp_path)


def subtasks(name: str) -> dict:
    part = {"name": name, "description": "d"}
    return {"first": part, "second": part}


def test_an_answer_in_the_wrong_form_goes_back_with_the_reason(tmp_path):
    bad = {
        "Invalid JSON": reply('{"first": {"na'),
        "second: Field required": reply('{"first": {"name": "a", "description": "b"}}'),
        "third: Extra inputs": reply(json.dumps({**subtasks("a"), "third": 1})),
        "first.name: Value error, it is empty": reply(json.dumps(subtasks(""))),
        "cut off at the limit of length": reply('{"first"', "truncated", "MAX_TOKENS"),
    }
    provider = Scripted(*bad.values(), reply(json.dumps(subtasks("a"))))
    for asks in (provider, None):
        record = Record(tmp_path, asks)
        assert Conversation(record, "question", 6).ask(["?"], Subtasks).first.name == "a"
        assert totals_of(record.used)["all"]["invalid_answers"] == len(bad)
    for retry, (reason, sent) in zip(provider.requests[1:], bad.items(), strict=True):
        assert retry.messages[-2].parts == (sent.answer,)
        assert reason in retry.messages[-1].parts[0]
    with pytest.raises(NoAnswerError, match=r"no usable answer in 2 attempts.*attempts="):
        Conversation(Record(tmp_path), "question", 2).ask(["?"], Subtasks)


def test_a_transcripts_totals_are_by_conversation_and_of_all(tmp_path):
    good = json.dumps(subtasks("a"))
    silent = Reply("answered", good, "", "m", None, None)
    script = [reply("no"), reply(good), reply('{"', "truncated"), silent, DOWN]
    record = live(tmp_path, *script, reply("", "refused", "SAFETY"))
    for name in ("question", "rank"):
        Conversation(record, name, 3).ask([name], Subtasks)
    # The request that nobody answered is no prompt; the one that was refused is.
    for error in (ProviderError, RefusalError):
        with pytest.raises(error):
            record.ask(request("else"), "reward/text")
    totals = totals_of(Record(tmp_path).exchanges)
    keys = ("prompts", "tokens_in", "tokens_out", "prompts_without_token_count", "invalid_answers")
    assert {name: tuple(row[key] for key in keys) for name, row in totals.items()} == {
        "question": (2, 20, 6, 0, 1),
        "rank": (2, 10, 3, 1, 1),
        "reward/text": (1, 10, 3, 0, 1),
        "all": (5, 40, 12, 1, 3),
    }
    assert in_words(totals["all"]) == (
        "5 prompts, 52 tokens (40 in, 12 out; 1 prompts not counted), 3 invalid answers"
    )


def places(*names: str, sure: tuple[float, ...] = (0.9, 0.5)) -> str:
    return json.dumps({"places": [{"name": name, "reason": "r"} for name in names], "sure": sure})


def test_a_ranking_is_a_permutation_of_its_list_and_says_how_sure_it_is():
    form = ranking(["a", "b+c", "d"])
    answer = form.model_validate_json(places("d", "a", "b+c")).model_dump()
    assert [place["name"] for place in answer["places"]] == ["d", "a", "b+c"]
    assert answer["sure"] == [0.9, 0.5]
    for wrong, message in [
        (places("d", "a", "a"), r"missing: b\+c; named twice: a"),
        (places("d", "a", "c+b"), r"'c\+b' is not one of a, b\+c, d"),
        (places("d", "a", "b+c", sure=(0.9, 0.49)), r"it must be 2 numbers from 0\.5 to 1"),
    ]:
        with pytest.raises(ValidationError, match=message):
            form.model_validate_json(wrong)
