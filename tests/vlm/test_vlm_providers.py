"""The real SDKs against a server on this machine."""

from __future__ import annotations

import base64
import json
import logging
import sys
import traceback
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest
from vlm_server import KEY, Server, by_schema

from needlehoop.config import strict
from needlehoop.vlm.messages import Message, Png, Request
from needlehoop.vlm.providers import build_provider, contract
from needlehoop.vlm.providers.contract import (
    LiveConfig,
    Provider,
    ProviderError,
    Reply,
)
from needlehoop.vlm.recorder import persist

PICTURE = Png(b"\x89PNG not really")
SCHEMA = {
    "type": "object",
    "properties": {"a": {"type": "string"}},
    "required": ["a"],
    "additionalProperties": False,
}
REQUEST = Request(
    (
        Message("user", ("What is this?", PICTURE)),
        Message("assistant", ('{"a": "a picture"}',)),
        Message("user", ("And now?",)),
    ),
    SCHEMA,
)

NOWHERE = Path("nowhere")


@pytest.fixture(params=["gemini", "openai"], scope="module")
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


def config_of(kind: str, server: Server | None, **changes) -> LiveConfig:
    values = {
        "kind": kind,
        "model": "test-model",
        "key": "TEST_KEY",
        "base_url": (server.url + ("/v1" if kind == "openai" else "")) if server else None,
        "sampling": {"temperature": 2.0, "top_p": None, "seed": 7},
        "timeout": 20.0,
        "tries": 4,
        "first_wait": 2.0,
        "longest_wait": 5.0,
    }
    return LiveConfig(**{**values, **changes})


@pytest.fixture
def provider(kind: str, server: Server) -> Iterator[Provider]:
    provider = build_provider(config_of(kind, server), NOWHERE)
    yield provider
    provider.close()


def test_an_answer_with_its_model_and_tokens(provider, kind, server):
    server.script = ['{"a": "b"}']
    reply = provider.ask(REQUEST)
    model = {"gemini": "gemini-test-001", "openai": "test-model-001"}[kind]
    assert reply == Reply("answered", '{"a": "b"}', "", model, 100, 15)


def test_the_whole_conversation_is_sent_with_pictures_schema_and_sampling(provider, kind, server):
    provider.ask(REQUEST)
    (body,) = server.requests
    data = base64.b64encode(PICTURE.png).decode()
    if kind == "gemini":
        assert [turn["role"] for turn in body["contents"]] == ["user", "model", "user"]
        first = body["contents"][0]["parts"]
        assert first[0]["text"] == "What is this?"
        assert first[1]["inlineData"]["mime_type"] == "image/png"
        assert base64.urlsafe_b64decode(first[1]["inlineData"]["data"]) == PICTURE.png
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


def test_passing_errors_are_retried_with_growing_waits(provider, kind, server):
    server.script = [{"status": 429}, {"status": 500}, {"status": 408}, '{"a": "b"}']
    waits: list[float] = []
    reply, attempts = persist(lambda: provider.ask(REQUEST), config_of(kind, server), waits.append)
    assert reply.answer == '{"a": "b"}'
    assert attempts == (429, 500, 408, 200)
    assert waits == [2.0, 4.0, 5.0]
    assert len(server.requests) == 4


def test_tries_are_bounded(provider, kind, server):
    server.script = [{"status": 503} for _ in range(9)]
    waits: list[float] = []
    with pytest.raises(ProviderError, match=r"503.*tried 4 times") as caught:
        persist(lambda: provider.ask(REQUEST), config_of(kind, server), waits.append)
    assert caught.value.attempts == (503,) * 4
    assert len(server.requests) == 4
    assert len(waits) == 3


def test_other_errors_are_final(provider, kind, server):
    for status in (400, 401, 404, 409):
        server.script = [{"status": status}]
        with pytest.raises(ProviderError, match=str(status)) as caught:
            persist(lambda: provider.ask(REQUEST), config_of(kind, server), pytest.fail)
        assert caught.value.attempts == (status,)
    assert len(server.requests) == 4


def test_a_server_that_is_not_there_is_final(kind, monkeypatch):
    monkeypatch.setenv("TEST_KEY", KEY)
    provider = build_provider(config_of(kind, None, base_url="http://127.0.0.1:9/v1"), NOWHERE)
    with pytest.raises(ProviderError, match="unreachable") as caught:
        provider.ask(REQUEST)
    assert not caught.value.passing
    provider.close()


def test_what_is_no_whole_answer_is_an_outcome_of_its_own(provider, kind, server):
    cut = {"gemini": "MAX_TOKENS", "openai": "length"}[kind]
    filtered = {"gemini": "SAFETY", "openai": "content_filter"}[kind]
    for said, outcome, detail in (
        ({"text": '{"a": "b', "finish": cut}, "truncated", cut),
        ({"refusal": "SAFETY", "text": ""}, "refused", "SAFETY"),
        ({"text": "half", "finish": filtered}, "refused", filtered),
        ({"text": " \n", "finish": cut}, "empty", cut),
    ):
        server.script = [said]
        reply = provider.ask(REQUEST)
        assert (reply.outcome, reply.detail) == (outcome, detail)
        assert reply.answer == said["text"]


def test_a_missing_key_is_an_error_before_any_work(kind, monkeypatch):
    monkeypatch.delenv("TEST_KEY", raising=False)
    with pytest.raises(ValueError, match=r"vlm.key: the environment variable TEST_KEY is not set"):
        build_provider(config_of(kind, None), NOWHERE)


def test_a_server_without_keys_is_asked_without_one(kind, server):
    provider = build_provider(config_of(kind, server, key=None), NOWHERE)
    assert provider.ask(REQUEST).outcome == "answered"
    provider.close()


def test_a_missing_package_says_what_to_install(kind, monkeypatch):
    monkeypatch.setenv("TEST_KEY", KEY)
    monkeypatch.setitem(sys.modules, {"gemini": "google.genai", "openai": "openai"}[kind], None)
    with pytest.raises(RuntimeError, match=r"pip install 'needlehoop\[vlm\]'"):
        build_provider(config_of(kind, None), NOWHERE)


def test_the_key_is_sent_and_goes_nowhere_else(provider, kind, server, caplog):
    caplog.set_level(logging.DEBUG)
    echo = json.dumps({"error": {"message": f"bad key {KEY}", "code": 401}})
    server.script = [{"status": 401, "body": echo}]
    with pytest.raises(ProviderError) as caught:
        provider.ask(REQUEST)
    assert any(KEY in str(headers) for headers in server.headers)
    said = "".join(traceback.format_exception(caught.value))
    assert "bad key ***" in said
    assert KEY not in said
    assert KEY not in caplog.text
    assert KEY not in repr(provider.__dict__["_config"])


def test_a_key_in_place_of_its_variable_is_refused_unrepeated(kind):
    with pytest.raises(ValueError, match="name of an environment variable") as caught:
        config_of(kind, None, key=KEY)
    assert KEY not in str(caught.value)


def test_unknown_kinds_and_settings_name_the_valid_ones(monkeypatch):
    monkeypatch.setenv("TEST_KEY", KEY)
    with pytest.raises(ValueError, match="choose from replay, gemini, openai"):
        contract.config_of("bard")
    with pytest.raises(ValueError, match=r"vlm.sampling: unknown key 'heat'"):
        build_provider(config_of("gemini", None, sampling={"heat": 2}), NOWHERE)
    values = asdict(config_of("gemini", None))
    for key, value in (("tries", 0), ("timeout", 0), ("first_wait", -1), ("longest_wait", -1)):
        with pytest.raises(ValueError, match=rf"vlm\.{key}: {value}"):
            strict.structure({**values, key: value}, LiveConfig, "vlm")


def test_the_made_up_answers_fit_their_schema():
    assert json.loads(by_schema(SCHEMA)) == {"a": "so be it"}
