"""Providers against a server on this machine."""

from __future__ import annotations

import base64
import json
import logging
import traceback
from collections.abc import Iterator
from dataclasses import asdict

import pytest
from vlm_server import KEY, Server, by_schema

from needlehoop.config import strict
from needlehoop.vlm import config
from needlehoop.vlm.config import LiveConfig
from needlehoop.vlm.messages import Message, Png, Provider, ProviderError, Reply, Request
from needlehoop.vlm.providers.server import Server as Model

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
    """One that tries once."""
    provider = Model(config_of(kind, server, tries=1))
    yield provider
    provider.close()


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds between tries, which are not waited for."""
    found: list[float] = []
    monkeypatch.setattr("needlehoop.vlm.providers.server.sleep", found.append)
    return found


def test_an_answer_with_its_model_and_tokens(provider, kind, server):
    server.script = ['{"a": "b"}']
    reply = provider.ask(REQUEST)
    model = {"gemini": "gemini-test-001", "openai": "test-model-001"}[kind]
    assert reply == Reply("answered", '{"a": "b"}', "", model, 100, 15, (200,))


def test_the_whole_conversation_is_sent_with_pictures_schema_and_sampling(provider, kind, server):
    provider.ask(REQUEST)
    (body,) = server.requests
    data = base64.b64encode(PICTURE.png).decode()
    if kind == "gemini":
        assert [turn["role"] for turn in body["contents"]] == ["user", "model", "user"]
        first = body["contents"][0]["parts"]
        assert first[0]["text"] == "What is this?"
        assert first[1]["inlineData"]["mimeType"] == "image/png"
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


def test_names_of_geminis_sampling_are_spelt_as_it_spells_them(server):
    safety = [{"category": "HARM_CATEGORY_HARASSMENT", "threshold": "BLOCK_NONE"}]
    sampling = {"max_output_tokens": 7, "safety_settings": safety}
    config = config_of("gemini", server, sampling=sampling, model="tunedModels/own")
    Model(config).ask(REQUEST)
    (body,) = server.requests
    assert body["generationConfig"]["maxOutputTokens"] == 7
    assert body["safetySettings"] == safety
    assert "safetySettings" not in body["generationConfig"]
    assert server.paths == ["/v1/tunedModels/own:generateContent"]


def test_passing_errors_are_retried_with_growing_waits(kind, server, waits):
    server.script = [{"status": 429}, {"status": 500}, {"status": 408}, '{"a": "b"}']
    reply = Model(config_of(kind, server)).ask(REQUEST)
    assert reply.answer == '{"a": "b"}'
    assert reply.attempts == (429, 500, 408, 200)
    assert waits == [2.0, 4.0, 5.0]
    assert len(server.requests) == 4


def test_tries_are_bounded(kind, server, waits):
    server.script = [{"status": 503} for _ in range(9)]
    with pytest.raises(ProviderError, match=r"503.*tried 4 times") as caught:
        Model(config_of(kind, server)).ask(REQUEST)
    assert caught.value.attempts == (503,) * 4
    assert len(server.requests) == 4
    assert len(waits) == 3


def test_other_errors_are_final(kind, server, waits):
    for status in (400, 401, 404, 409):
        server.script = [{"status": status}]
        with pytest.raises(ProviderError, match=str(status)) as caught:
            Model(config_of(kind, server)).ask(REQUEST)
        assert caught.value.attempts == (status,)
    assert len(server.requests) == 4
    assert waits == []


def test_a_server_that_is_not_there_is_final(kind, monkeypatch):
    monkeypatch.setenv("TEST_KEY", KEY)
    provider = Model(config_of(kind, None, base_url="http://127.0.0.1:9/v1"))
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
        Model(config_of(kind, None))


def test_a_server_without_keys_is_asked_without_one(kind, server):
    provider = Model(config_of(kind, server, key=None))
    assert provider.ask(REQUEST).outcome == "answered"
    provider.close()


def test_the_password_of_netrc_is_not_sent(kind, server, tmp_path, monkeypatch):
    (tmp_path / "netrc").write_text("machine 127.0.0.1 login me password secret")
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    Model(config_of(kind, server)).ask(REQUEST)
    Model(config_of(kind, server, key=None)).ask(REQUEST)
    assert "Basic" not in str(server.headers)


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
        config.config_of("bard")
    with pytest.raises(ValueError, match=r"vlm.sampling: 'heat' is unknown; choose from temp"):
        Model(config_of("gemini", None, sampling={"heat": 2}))
    values = asdict(config_of("gemini", None))
    for key, value in (("tries", 0), ("timeout", 0), ("first_wait", -1), ("longest_wait", -1)):
        with pytest.raises(ValueError, match=rf"vlm\.{key}: {value}"):
            strict.structure({**values, key: value}, LiveConfig, "vlm")


def test_the_made_up_answers_fit_their_schema():
    assert json.loads(by_schema(SCHEMA)) == {"a": "so be it"}
