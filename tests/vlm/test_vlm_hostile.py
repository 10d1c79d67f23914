"""Servers that lie, drip, flood, redirect and repeat the key."""

from __future__ import annotations

import gzip
import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from test_vlm_providers import REQUEST, config_of, kind, provider, waits
from vlm_server import KEY, by_schema, gemini_reply, openai_reply, serve

from needlehoop.cli.main import main
from needlehoop.vlm.config import TRANSCRIPT
from needlehoop.vlm.messages import Message, Provider, ProviderError, Request
from needlehoop.vlm.providers.server import LARGEST
from needlehoop.vlm.providers.server import Server as Model
from needlehoop.vlm.record import Record, RefusalError

__all__ = ["kind", "provider", "waits"]
"""Fixtures of the other file."""


def asked(words: str) -> Request:
    """One that nothing recorded answers."""
    return Request((Message("user", (words,)),), REQUEST.schema)


def reply(kind: str, text: Any = '{"a": "b"}') -> dict[str, Any]:
    return {"gemini": gemini_reply, "openai": openai_reply}[kind]({"text": text})


def changed(kind: str, path: dict[str, str], value: Any) -> str:
    """A reply with something else in one place."""
    found = reply(kind)
    *above, last = path[kind].split(".")
    at: Any = found
    for key in above:
        at = at[int(key) if key.isdigit() else key]
    at[int(last) if last.isdigit() else last] = value
    return json.dumps(found)


CHOICES = {"gemini": "candidates", "openai": "choices"}
CHOICE = {"gemini": "candidates.0", "openai": "choices.0"}
MESSAGE = {"gemini": "candidates.0.content", "openai": "choices.0.message"}
CONTENT = {"gemini": "candidates.0.content.parts.0.text", "openai": "choices.0.message.content"}
FINISH = {"gemini": "candidates.0.finishReason", "openai": "choices.0.finish_reason"}
USAGE = {"gemini": "usageMetadata", "openai": "usage"}
TOKENS = {"gemini": "usageMetadata.promptTokenCount", "openai": "usage.prompt_tokens"}
MODEL = {"gemini": "modelVersion", "openai": "model"}

MALFORMED = {
    **{f"choices {v!r}": (CHOICES, v) for v in (5, "no", {"a": 1}, [5], [None], [[]])},
    **{f"choice {v!r}": (CHOICE, v) for v in (5, "no")},
    **{f"message {v!r}": (MESSAGE, v) for v in (5, "no", [])},
    **{f"content {v!r}": (CONTENT, v) for v in (5, True, ["a"], {"a": 1})},
    **{f"finish {v!r}": (FINISH, v) for v in (5, ["stop"], {})},
    **{f"usage {v!r}": (USAGE, v) for v in ("many", 5, [1])},
    **{f"tokens {v!r}": (TOKENS, v) for v in ("many", -1, 1.5, [1], 10**30)},
    **{f"model {v!r}": (MODEL, v) for v in (5, ["a"], {})},
    "half a character": (CONTENT, "\ud800"),
    "half a character in the model": (MODEL, "\udfff"),
}

BODIES: dict[str, str | bytes] = {
    "5": "5",
    "null": "null",
    "[]": "[]",
    '"text"': '"text"',
    "nothing": "",
    "HTML": "<html>welcome</html>",
    "NaN": "NaN",
    "bad UTF-8": b'{"choices": "\xff\xfe"}',
    "deep": '{"choices": ' + "[" * 200_000,
    "deep and whole": "[" * 3_000 + "]" * 3_000,
    "cut off": '{"choices": [{"mess',
}


def unreadable(provider: Provider) -> str:
    with pytest.raises(ProviderError, match="unreadable") as caught:
        provider.ask(REQUEST)
    assert caught.value.passing
    said = str(caught.value)
    assert "\n" not in said
    assert len(said) < 400
    return said


def test_every_malformed_reply_is_unreadable_and_passing(provider, kind, server):
    for path, value in MALFORMED.values():
        server.script = [{"body": changed(kind, path, value)}]
        unreadable(provider)
    for body in BODIES.values():
        server.script = [{"body": body}]
        if (kind, body) == ("gemini", "[]"):
            continue
        unreadable(provider)


def test_a_message_that_is_missing_is_unreadable(provider, kind, server):
    if kind == "openai":
        for path, value in ((MESSAGE, None), (CHOICES, []), (CHOICES, None)):
            server.script = [{"body": changed(kind, path, value)}]
            unreadable(provider)
    else:
        # Gemini leaves these out where a filter has been at work.
        for path in (MESSAGE, CHOICES, CONTENT):
            server.script = [{"body": changed(kind, path, None)}]
            assert provider.ask(REQUEST).outcome == "empty"


def test_what_is_not_asked_for_may_be_anything(provider, kind, server):
    server.script = [{"body": json.dumps({**reply(kind), "created": "x", "safety": [[5]]})}]
    assert provider.ask(REQUEST).answer == '{"a": "b"}'


def test_an_unreadable_reply_is_counted_and_tried_again(kind, server, waits):
    server.script = [{"body": "5"}, {"body": "{"}, '{"a": "b"}']
    found = Model(config_of(kind, server)).ask(REQUEST)
    assert found.answer == '{"a": "b"}'
    assert found.attempts == ("unreadable", "unreadable", 200)
    assert waits == [2.0, 4.0]


def test_an_error_of_any_form_is_told_in_a_line(provider, server):
    for body in ("5", "null", "[" * 100_000, '"text"', "", "\x1b[31mred", "\ud800"):
        for status in (201, 204, 302, 400, 500, 599):
            data = body.encode("utf-8", "surrogatepass") if status != 204 else b""
            server.script = [{"status": status, "body": data}]
            with pytest.raises(ProviderError) as caught:
                provider.ask(REQUEST)
            said = str(caught.value)
            assert said.isprintable()
            assert len(said) < 400


def test_the_timeout_bounds_the_whole_try(kind, server):
    """A byte now and then keeps each wait short."""
    provider = Model(config_of(kind, server, timeout=0.6, tries=1))
    server.script = [{"body": json.dumps(reply(kind)), "drip": 0.1}, '{"a": "b"}']
    began = time.monotonic()
    with pytest.raises(ProviderError, match=r"timeout: no answer within 0.6 s") as caught:
        provider.ask(REQUEST)
    assert time.monotonic() - began < 3.0
    assert caught.value.passing
    # The next try is another connection's.
    slow = Model(config_of(kind, server))
    assert slow.ask(REQUEST).answer == '{"a": "b"}'
    slow.close()
    provider.close()


def test_an_answer_that_is_too_large_is_cut_off_while_it_arrives(provider, server):
    before = server.sent
    server.script = [{"body": b" " * 50_000_000}]
    assert f"larger than {LARGEST:,} bytes" in unreadable(provider)
    assert server.sent - before < 40_000_000


def test_nothing_compressed_is_unpacked(provider, server):
    packed = gzip.compress(b"[" + b" " * 20_000_000 + b"]")
    server.script = [{"body": packed, "headers": {"Content-Encoding": "gzip"}}]
    assert "is compressed, unasked" in unreadable(provider)
    assert server.headers[-1]["Accept-Encoding"] == "identity"


def test_a_redirect_is_not_followed_with_the_key(provider, server):
    with serve() as other:
        for status in (301, 302, 303, 307, 308):
            server.script = [{"status": status, "headers": {"Location": f"{other.url}/v1/x"}}]
            said = f"{status}: .*redirects to '{other.url}"
            with pytest.raises(ProviderError, match=said) as caught:
                provider.ask(REQUEST)
            assert not caught.value.passing
        assert other.requests == []


def test_a_key_that_is_repeated_is_struck_out_everywhere(kind, server, tmp_path):
    """In the answer as it is and spelt in JSON's way, in the model's name and the reason."""
    spelt = KEY.replace("s", "\\u0073")
    provider = Model(config_of(kind, server))
    record = Record(tmp_path, provider)
    for name, text in (("plain", f'{{"a": "{KEY}"}}'), ("spelt", f'{{"a": "{spelt}"}}')):
        server.script = [{"body": changed(kind, CONTENT, text)}]
        answer = record.ask(asked(name), "question").answer
        assert json.loads(answer) == {"a": "***"}
    server.script = [{"body": changed(kind, MODEL, f"model-{KEY}")}]
    assert record.ask(asked("model"), "question").answered_by == "model-***"
    refused = json.loads(changed(kind, CONTENT, ""))
    refused[CHOICES[kind]][0][FINISH[kind].rpartition(".")[2]] = f"odd {KEY}"
    server.script = [{"body": json.dumps(refused)}]
    with pytest.raises(RefusalError, match=r"odd \*\*\*"):
        record.ask(asked("finish"), "question")
    assert KEY not in (tmp_path / TRANSCRIPT).read_text()
    record.close()


def test_what_a_server_says_never_breaks_the_next_call(kind, server, tmp_path):
    config = config_of(kind, server, tries=1)
    for text in ("\ud800", "\x00\x1b[2J", "\u202e", "x" * 10_000):
        error = {"status": 500, "body": json.dumps({"error": {"message": text}})}
        entries = [{"body": changed(kind, path, text)} for path in (CONTENT, MODEL)]
        folder = tmp_path / text.encode("utf-8", "replace").hex()[:20]
        for number, entry in enumerate([*entries, error]):
            live = Model(config)
            record = Record(folder, live)
            server.script = [entry]
            with suppress(ProviderError):
                record.ask(asked(f"{number}"), "question")
            record.close()
        assert len(Record(folder).exchanges) == 3


def test_no_control_character_reaches_the_terminal(server, capsys):
    evil = "\x1b]0;owned\x07"

    def answer(schema: dict[str, Any], prompt: str) -> str:
        return by_schema(schema).replace("so be it", "so\\u001b]0;owned\\u0007 be it")

    server.otherwise = answer
    words = ["vlm=openai", "vlm.model=m", "vlm.key=TEST_KEY", f"vlm.base_url={server.url}/v1"]
    status = main(["vlm", "question", *words, "vlm.first_wait=0", "size=16"])
    said = capsys.readouterr()
    assert evil not in said.out + said.err
    assert "\x1b" not in said.out + said.err
    assert status == 0
    assert (Path("results/main/vlm") / TRANSCRIPT).exists()
