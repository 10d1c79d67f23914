"""The SDKs of Gemini and OpenAI against a server on this machine."""

from __future__ import annotations

import base64
import json
import logging
import sys
import traceback
from pathlib import Path

import pytest
from vlm_server import KEY, Server

from needlehoop.vlm.config import LiveConfig
from needlehoop.vlm.messages import Message, Png, ProviderError, Reply, Request
from needlehoop.vlm.providers import provider_of

PICTURE = Png(b"\x89PNG not really")
SCHEMA = {"type": "object", "properties": {"a": {"type": "string"}}, "required": ["a"]}
REQUEST = Request(
    (
        Message("user", ("What is this?", PICTURE)),
        Message("assistant", ('{"a": "a picture"}',)),
        Message("user", ("And now?",)),
    ),
    SCHEMA,
)


@pytest.fixture(params=["gemini", "openai"])
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


def config_of(kind: str, url: str, **changes) -> LiveConfig:
    values = {
        "kind": kind,
        "model": "test-model",
        "key": "TEST_KEY",
        "base_url": url + ("/v1" if kind == "openai" else ""),
        "sampling": {"temperature": 2.0, "top_p": None, "seed": 7},
        "timeout": 20.0,
        "tries": 3,
    }
    return LiveConfig(**{**values, **changes})


def ask(kind: str, server: Server, **changes) -> Reply:
    return provider_of(config_of(kind, server.url, **changes), Path()).ask(REQUEST)


def test_the_whole_conversation_is_sent_with_pictures_schema_and_sampling(kind, server):
    server.script = ['{"a": "b"}']
    model = {"gemini": "gemini-test-001", "openai": "test-model-001"}[kind]
    assert ask(kind, server) == Reply("answered", '{"a": "b"}', "", model, 100, 15, (200,))
    (body,) = server.requests
    data = base64.b64encode(PICTURE.png).decode()
    if kind == "gemini":
        assert [turn["role"] for turn in body["contents"]] == ["user", "model", "user"]
        first = body["contents"][0]["parts"]
        assert first[0]["text"] == "What is this?"
        assert first[1]["inlineData"]["data"] == data
        options = body["generationConfig"]
        assert options["responseJsonSchema"] == SCHEMA
    else:
        assert [turn["role"] for turn in body["messages"]] == ["user", "assistant", "user"]
        pieces = body["messages"][0]["content"]
        assert pieces[0] == {"type": "text", "text": "What is this?"}
        assert pieces[1]["image_url"]["url"] == f"data:image/png;base64,{data}"
        assert body["response_format"]["json_schema"]["schema"] == SCHEMA
        assert body["model"] == "test-model"
        options = body
    assert (options["temperature"], options["seed"]) == (2.0, 7)
    assert not {"top_p", "topP"} & set(options)


def test_passing_errors_are_tried_again_and_other_errors_are_final(kind, server):
    server.script = [{"status": 429}, {"status": 500}, '{"a": "b"}']
    assert ask(kind, server).answer == '{"a": "b"}'
    for status, tries in ((503, 3), (400, 1)):
        server.requests, server.script = [], [{"status": status}] * 5
        with pytest.raises(
            ProviderError, match=rf"vlm={kind} \(test-model\): {status}: "
        ) as caught:
            ask(kind, server)
        assert caught.value.status == status
        assert len(server.requests) == tries


def test_a_server_that_is_not_there_or_answers_otherwise_is_an_error_in_a_line(kind, server):
    with pytest.raises(ProviderError, match=r"Connect.*: .*refused"):
        provider_of(config_of(kind, "http://127.0.0.1:9", tries=1), Path()).ask(REQUEST)
    server.script = [{"body": "<html>\nwelcome</html>"}]
    with pytest.raises(ProviderError) as caught:
        ask(kind, server)
    assert "\n" not in str(caught.value)


def test_what_is_no_whole_answer_is_an_outcome_of_its_own(kind, server):
    cut = {"gemini": "MAX_TOKENS", "openai": "length"}[kind]
    filtered = {"gemini": "SAFETY", "openai": "content_filter"}[kind]
    for entry, outcome, detail in (
        ({"text": '{"a": "b', "finish": cut}, "truncated", cut),
        ({"refusal": "SAFETY", "text": ""}, "refused", "SAFETY"),
        ({"text": "half", "finish": filtered}, "refused", filtered),
        ({"text": " \n", "finish": cut}, "empty", cut),
    ):
        server.script = [entry]
        reply = ask(kind, server)
        assert (reply.outcome, reply.detail, reply.answer) == (outcome, detail, entry["text"])


def test_the_key_is_sent_and_goes_nowhere_else(kind, server, caplog):
    caplog.set_level(logging.DEBUG)
    echo = json.dumps({"error": {"message": f"bad key {KEY}", "code": 401}})
    server.script = [{"status": 401, "body": echo}]
    with pytest.raises(ProviderError) as caught:
        ask(kind, server)
    assert any(KEY in str(headers) for headers in server.headers)
    trace = "".join(traceback.format_exception(caught.value))
    assert "bad key ***" in trace
    assert KEY not in trace + caplog.text
    server.headers.clear()
    assert ask(kind, server, key=None).outcome == "answered"
    assert KEY not in str(server.headers)


def test_a_bad_key_setting_is_an_error_before_any_work(kind, server, monkeypatch):
    monkeypatch.delenv("TEST_KEY")
    with pytest.raises(ValueError, match=r"vlm.key: the environment variable TEST_KEY is not set"):
        ask(kind, server)
    monkeypatch.setenv("TEST_KEY", KEY)
    with pytest.raises(ValueError, match=r"vlm.sampling: 'heat' is unknown; choose from .*temp"):
        ask("gemini", server, sampling={"heat": 2})
    # The key in place of its variable's name is not repeated.
    with pytest.raises(ValueError, match="name of an environment variable") as caught:
        config_of(kind, server.url, key=KEY)
    assert KEY not in str(caught.value)
    monkeypatch.setitem(sys.modules, {"gemini": "google.genai", "openai": "openai"}[kind], None)
    with pytest.raises(ValueError, match=rf"pip install 'needlehoop\[{kind}\]'"):
        ask(kind, server)
