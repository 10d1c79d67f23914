"""Records, replay, conversations, forms: with a model made of a list of replies."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from needlehoop.vlm.config import LiveConfig
from needlehoop.vlm.conversation import (
    Conversation,
    NoAnswerError,
    ProgramAnswer,
    Subtasks,
    Verdict,
    choice,
    in_words,
    papers_totals,
    ranking,
    totals_of,
)
from needlehoop.vlm.messages import Message, Png, ProviderError, Reply, Request
from needlehoop.vlm.questions import agreement
from needlehoop.vlm.record import MissError, Record, RefusalError
from needlehoop.vlm.writing import ProgramRules, rows_of, write_program

CONFIG = LiveConfig(
    kind="gemini",
    model="asked-for",
    key=None,
    base_url=None,
    sampling={"temperature": 2.0, "seed": None},
    timeout=1.0,
    tries=2,
    first_wait=1.0,
    longest_wait=1.0,
)
PICTURE = Png(b"a picture")
PROMPTS = "c0ffee"
"""The hash of those that are asked."""


def reply(answer: str, outcome: str = "answered", detail: str = "") -> Reply:
    return Reply(outcome, answer, detail, "answered-by", 10, 3, ("timeout", 200))


DOWN = ProviderError("down", 503, (503, 503))


class Scripted:
    """A provider that gives what it is told to."""

    def __init__(self, *script: Reply | ProviderError, who: LiveConfig = CONFIG):
        self.script, self.who = list(script), who.who
        self.asked: list[Request] = []

    def ask(self, request: Request) -> Reply:
        self.asked.append(request)
        given = self.script.pop(0)
        if isinstance(given, ProviderError):
            raise given
        return given

    def close(self) -> None:
        pass


def live(folder: Path, *script: Reply | ProviderError, config: LiveConfig = CONFIG) -> Record:
    return Record(folder, Scripted(*script, who=config), PROMPTS)


def replay(folder: Path) -> Record:
    return Record(folder, prompts=PROMPTS)


def request(*texts: str, schema: dict | None = None) -> Request:
    return Request((Message("user", (*texts, PICTURE)),), schema or {"type": "object"})


def test_the_hash_of_a_request_is_golden():
    messages = (
        Message("user", ("Größe?", Png(b"png"))),
        Message("assistant", ("12",)),
        Message("user", ("Sure?",)),
    )
    asked = Request(messages, {"type": "object", "b": 1, "a": [2.5]})
    assert asked.sha256 == "c0533a0cf76d60ec257848db546dddf566c3f96966ae6da0dc21f87deb436f58"
    assert asked.sha256 == Request(messages, {"a": [2.5], "b": 1, "type": "object"}).sha256


def test_the_hash_covers_text_turns_pictures_and_form():
    others = [
        request("Which view?"),
        request("Which one?"),
        request("Which view?", " "),
        request("Which view?", schema={"type": "string"}),
        Request((Message("user", ("Which view?", Png(b"other"))),), {"type": "object"}),
        Request((Message("assistant", ("Which view?", PICTURE)),), {"type": "object"}),
    ]
    assert len({other.sha256 for other in others}) == len(others)


def test_an_exchange_is_a_whole_line(tmp_path):
    live(tmp_path, reply('{"ä": 1}')).ask(request("Which view?"), "question")
    (line,) = (tmp_path / "transcript.jsonl").read_text().splitlines()
    found = json.loads(line)
    assert found["sha256"] == request("Which view?").sha256
    assert found["request"] == request("Which view?").canonical()
    assert found["request"]["messages"][0]["parts"][1] == {"image": PICTURE.sha256}
    assert found["answer"] == '{"ä": 1}'
    assert found["sampling"] == {"temperature": 2.0}
    assert (found["provider"], found["model"]) == ("gemini", "asked-for")
    assert found["answered_by"] == "answered-by"
    assert (found["tokens_in"], found["tokens_out"]) == (10, 3)
    assert found["attempts"] == ["timeout", 200]
    assert found["seconds"] >= 0
    assert found["time"].endswith("Z")
    assert (tmp_path / "images" / f"{PICTURE.sha256}.png").read_bytes() == PICTURE.png


def test_pictures_are_kept_once_and_checked(tmp_path):
    record = live(tmp_path, reply("1"), reply("2"))
    record.ask(request("a"), "question")
    record.ask(request("b"), "question")
    (path,) = (tmp_path / "images").iterdir()
    assert record.picture(PICTURE.sha256) == PICTURE
    path.write_bytes(b"tampered with")
    with pytest.raises(ValueError, match="not what its name says"):
        record.picture(PICTURE.sha256)


def test_repeats_replay_in_order_and_then_run_out(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    again = live(tmp_path, reply("2"), reply("3"))
    # The record's own answer comes first: nothing is paid for twice.
    assert [again.ask(request("a"), "rank/2").answer for _ in range(3)] == ["1", "2", "3"]
    record = replay(tmp_path)
    assert [record.ask(request("a"), "rank").answer for _ in range(3)] == ["1", "2", "3"]
    with pytest.raises(MissError, match="answered 3 times, and they are used up"):
        record.ask(request("a"), "rank")


def test_a_miss_shows_the_nearest_recorded_request_and_what_differs(tmp_path):
    record = live(tmp_path, reply("1"), reply("2"))
    record.ask(request("The hoop is 36 mm high.\nWhich view?"), "question")
    record.ask(request("Something else altogether"), "rank")
    with pytest.raises(MissError) as caught:
        replay(tmp_path).ask(request("The hoop is 50 mm high.\nWhich view?"), "question")
    said = str(caught.value)
    assert "line 1, question" in said
    assert "-The hoop is 36 mm high." in said
    assert "+The hoop is 50 mm high." in said
    assert "altogether" not in said

    other = Request((Message("user", ("Something else altogether", Png(b"x"))),), {})
    with pytest.raises(MissError, match=r"  -picture [0-9a-f]{64}\n  -{\n  - \"type\": "):
        replay(tmp_path).ask(other, "question")


def test_a_miss_says_that_the_prompts_were_others(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    noted = json.loads((tmp_path / "prompts.json").read_text())
    assert noted["sha256"] == PROMPTS
    # As long as they are the same, what differs is shown.
    with pytest.raises(MissError, match="differs in"):
        replay(tmp_path).ask(request("b"), "question")
    (tmp_path / "prompts.json").write_text('{"commit": "8210a798af59", "sha256": "beef"}')
    with pytest.raises(MissError) as caught:
        replay(tmp_path).ask(request("b"), "question")
    assert "was recorded with the prompts of commit 8210a798af59" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert replay(tmp_path).ask(request("a"), "question").answer == "1"


def test_a_record_notes_new_prompts_and_keeps_the_old_note(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    note = tmp_path / "prompts.json"
    first = note.read_text()
    live(tmp_path, reply("2")).ask(request("b"), "question")
    assert note.read_text() == first
    assert not (tmp_path / "prompts.1.json").exists()
    note.write_text('{"commit": null, "sha256": "beef"}')
    live(tmp_path, reply("3")).ask(request("c"), "question")
    assert Record(tmp_path).edition()["sha256"] == PROMPTS
    assert json.loads((tmp_path / "prompts.1.json").read_text())["sha256"] == "beef"
    note.write_text("{")
    with pytest.raises(ValueError, match="not the note of an edition"):
        Record(tmp_path).edition()


def test_a_replay_without_a_recording_says_so(tmp_path):
    with pytest.raises(MissError, match="nothing is recorded"):
        replay(tmp_path).ask(request("a"), "question")


def test_a_line_cut_off_is_reported_skipped_and_cut_away(tmp_path):
    record = live(tmp_path, reply("1"), reply("zwölf"))
    record.ask(request("a"), "question")
    record.ask(request("b"), "question")
    path = tmp_path / "transcript.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rfind("ö".encode()) + 1])
    torn = Record(tmp_path, Scripted(reply("2")))
    assert torn.torn == f"{path}: line 2 is cut off and left out"
    assert [exchange.answer for exchange in torn.exchanges] == ["1"]
    torn.ask(request("b"), "question")
    assert [exchange.answer for exchange in Record(tmp_path).exchanges] == ["1", "2"]
    assert Record(tmp_path).torn is None


def test_a_damaged_line_in_the_middle_is_an_error(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    path = tmp_path / "transcript.jsonl"
    path.write_text('{"sha256": "beef"}\n' + path.read_text())
    with pytest.raises(ValueError, match="line 1 is no exchange"):
        Record(tmp_path)


def test_a_refusal_is_recorded_replayed_and_asked_again(tmp_path):
    with pytest.raises(RefusalError, match=r"refused to answer: SAFETY"):
        live(tmp_path, reply("", "refused", "SAFETY")).ask(request("a"), "question")
    with pytest.raises(RefusalError, match=r"refused to answer: SAFETY"):
        replay(tmp_path).ask(request("a"), "question")
    assert live(tmp_path, reply("well")).ask(request("a"), "question").answer == "well"
    assert replay(tmp_path).ask(request("a"), "question").answer == "well"
    with pytest.raises(RefusalError, match="gave an empty answer: MAX_TOKENS"):
        live(tmp_path, reply("", "empty", "MAX_TOKENS")).ask(request("b"), "question")


def test_a_failure_is_recorded_and_raised(tmp_path):
    with pytest.raises(ProviderError, match="down"):
        live(tmp_path, DOWN).ask(request("a"), "question")
    (exchange,) = Record(tmp_path).exchanges
    assert (exchange.outcome, exchange.attempts) == ("failed", (503, 503))
    with pytest.raises(MissError):
        replay(tmp_path).ask(request("a"), "question")


def test_a_transcript_is_of_one_model_and_sampling(tmp_path):
    live(tmp_path, reply("1")).ask(request("a"), "question")
    warmer = LiveConfig(**{**CONFIG.__dict__, "sampling": {"temperature": 1.0}})
    with pytest.raises(ValueError, match="choose another study="):
        live(tmp_path, config=warmer)


def test_a_conversation_carries_everything_said(tmp_path):
    first, second = json.dumps(subtasks("a")), json.dumps(subtasks("b"))
    provider = Scripted(reply(first), reply(second))
    conversation = Conversation(Record(tmp_path, provider), "question", 3)
    conversation.ask(["one?", PICTURE], Subtasks)
    conversation.ask(["two?"], Subtasks)
    assert [(message.role, message.parts) for message in provider.asked[1].messages] == [
        ("user", ("one?", PICTURE)),
        ("assistant", (first,)),
        ("user", ("two?",)),
    ]
    assert provider.asked[1].schema == Subtasks.model_json_schema()
    assert len(conversation.attempts) == 2


def subtasks(name: str) -> dict:
    part = {"name": name, "description": "d"}
    return {"first": part, "second": part}


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (reply('{"first": {"na'), "Invalid JSON"),
        (reply('{"first": {"name": "a", "description": "b"}}'), "second: Field required"),
        (reply(json.dumps({**subtasks("a"), "third": 1})), "third: Extra inputs"),
        (reply(json.dumps(subtasks(""))), "first.name: Value error, it is empty"),
        (reply('{"first"', "truncated", "MAX_TOKENS"), "cut off at the limit of length"),
    ],
)
def test_an_answer_in_the_wrong_form_goes_back_with_the_reason(tmp_path, bad, reason):
    provider = Scripted(bad, reply(json.dumps(subtasks("a"))))
    record = Record(tmp_path, provider)
    assert Conversation(record, "question", 3).ask(["?"], Subtasks).first.name == "a"
    correction = provider.asked[1].messages[-1].parts[0]
    assert reason in correction
    assert provider.asked[1].messages[-2].parts == (bad.answer,)
    assert totals_of(record.used)["question"] == {
        "prompts": 2,
        "tokens_in": 20,
        "tokens_out": 6,
        "prompts_without_token_count": 0,
        "invalid_answers": 1,
    }
    assert len(Record(tmp_path).exchanges) == 2
    again = replay(tmp_path)
    assert Conversation(again, "question", 3).ask(["?"], Subtasks).first.name == "a"
    assert totals_of(again.used) == totals_of(record.used)


def test_attempts_are_bounded(tmp_path):
    provider = Scripted(*[reply("no")] * 9)
    conversation = Conversation(Record(tmp_path, provider), "question", 3)
    with pytest.raises(NoAnswerError, match=r"no usable answer in 3 attempts.*attempts="):
        conversation.ask(["?"], Subtasks)
    assert len(provider.asked) == 3
    assert [answer for _, answer, _ in conversation.attempts] == [None] * 3


def test_a_transcripts_totals_are_by_conversation_and_of_all(tmp_path):
    good = json.dumps(subtasks("a"))
    silent = Reply("answered", good, "", "m", None, None)
    script = [reply("no"), reply(good), reply('{"', "truncated"), silent, DOWN]
    record = live(tmp_path, *script, reply("", "refused", "SAFETY"))
    held = [Conversation(record, name, 3) for name in ("question", "rank")]
    for conversation in held:
        conversation.ask([conversation.name], Subtasks)
    for error in (ProviderError, RefusalError):
        with pytest.raises(error):
            record.ask(request("else"), "reward/text")
    found = totals_of(Record(tmp_path).exchanges)
    assert found == totals_of(record.exchanges)
    assert list(found) == ["question", "rank", "reward/text", "all"]
    assert found["question"] == {
        "prompts": 2,
        "tokens_in": 20,
        "tokens_out": 6,
        "prompts_without_token_count": 0,
        "invalid_answers": 1,
    }
    assert found["rank"]["prompts_without_token_count"] == 1
    assert found["rank"]["invalid_answers"] == 1
    # The request that nobody answered is no prompt; the one that was refused is.
    assert found["reward/text"]["prompts"] == found["reward/text"]["invalid_answers"] == 1
    for key, value in found["all"].items():
        assert value == sum(row[key] for name, row in found.items() if name != "all")
    assert in_words(found["all"]) == (
        "5 prompts, 52 tokens (40 in, 12 out; 1 prompts not counted), 3 invalid answers"
    )
    assert papers_totals() == "25 prompts, 14137 tokens"


def places(*names: str, sure: tuple[float, ...] = (0.9, 0.5)) -> str:
    return json.dumps({"places": [{"name": name, "reason": "r"} for name in names], "sure": sure})


def test_a_ranking_is_a_permutation_of_its_list():
    form = ranking(["a", "b+c", "d"])
    answer = form.model_validate_json(places("d", "a", "b+c"))
    assert [place["name"] for place in answer.model_dump()["places"]] == ["d", "a", "b+c"]
    for wrong, said in [
        (("d", "a"), r"missing: b\+c; named twice: none"),
        (("d", "a", "a"), r"missing: b\+c; named twice: a"),
        (("d", "a", "b+c", "d"), "named twice: d"),
        (("d", "a", "c+b"), r"'c\+b' is not one of a, b\+c, d"),
        ((), "missing"),
    ]:
        with pytest.raises(ValidationError, match=said):
            form.model_validate_json(places(*wrong))


def test_a_ranking_says_how_sure_each_place_is():
    form = ranking(["a", "b", "c"])
    assert form.model_validate_json(places("b", "a", "c")).model_dump()["sure"] == [0.9, 0.5]
    for sure in ((), (0.9, 0.49), (0.9, 1.01), (0.9, 0.5, 0.5)):
        with pytest.raises(ValidationError, match=r"it must be 2 numbers from 0\.5 to 1"):
            form.model_validate_json(places("b", "a", "c", sure=sure))


def test_a_choice_is_among_what_was_shown():
    form = choice(["front", "side"], ["rgb", "dep"])
    names = form.model_json_schema()["properties"]
    assert names["view"] == {"type": "string", "enum": ["front", "side"]}
    assert "title" not in json.dumps(form.model_json_schema())
    part = Subtasks.model_json_schema()["$defs"]["Subtask"]
    assert part["required"] == ["name", "description"]
    assert part["properties"]["description"] == {"type": "string"}
    assert "description" not in part
    with pytest.raises(ValidationError, match="'top' is not one of front, side"):
        form.model_validate(
            {"view": "top", "view_reason": "r", "rendering": "rgb", "rendering_reason": "r"}
        )


def test_agreement_of_samples():
    assert agreement([["a", "b", "c"]]) is None
    assert agreement([["a", "b", "c"], ["a", "b", "c"]]) == {"tau_b": 1.0, "same_top": 1.0}
    assert agreement([["a", "b", "c"], ["c", "b", "a"]])["tau_b"] == pytest.approx(-1.0)
    found = agreement([["a", "b", "c"], ["a", "c", "b"], ["b", "a", "c"]])
    assert found["tau_b"] == pytest.approx((1 / 3 + 1 / 3 - 1 / 3) / 3)
    assert found["same_top"] == pytest.approx(2 / 3)


def program(text: str) -> Reply:
    return reply(json.dumps({"explanation": "e", "program": text}))


def judge(source: str) -> Verdict:
    good = source == "reward = 9\n"
    return Verdict(None if good else "line 1, column 1: no", {"lines": 1})


def test_a_refused_program_goes_back_with_the_reason_and_is_kept(tmp_path):
    provider = Scripted(program("import os"), reply("{}"), program("```python\nreward = 9\n```"))
    record = Record(tmp_path, provider)
    rules = ProgramRules(0.0, 9.0, judge)
    conversation = Conversation(record, "reward/text", 3)
    assert write_program(conversation, rules, ["write"]) == "reward = 9\n"
    assert "line 1, column 1: no" in provider.asked[1].messages[-1].parts[0]
    rows = rows_of(conversation)
    assert [row["accepted"] for row in rows] == [False, False, True]
    assert [row["program"] for row in rows] == ["import os\n", None, "reward = 9\n"]
    assert [row["card"] for row in rows] == [{"lines": 1}, None, {"lines": 1}]
    assert "Field required" in rows[1]["reason"]
    assert ProgramAnswer.model_json_schema()["required"] == ["explanation", "program"]
