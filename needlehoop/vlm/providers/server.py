"""Models behind servers: Google's Gemini, and any with OpenAI's chat completions.

A server may be hostile: it floods, drips, redirects, lies, or repeats the key.
"""

from __future__ import annotations

import base64
import re
import time
from dataclasses import replace
from time import sleep
from typing import Annotated, Any

import requests
from pydantic import AliasPath, BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel
from urllib3.exceptions import HTTPError, ProtocolError, ReadTimeoutError

from needlehoop.config.strict import check_names
from needlehoop.runs.reading import UnreadableError, parse_json, printable
from needlehoop.vlm.config import LiveConfig
from needlehoop.vlm.messages import Part, ProviderError, Reply, Request, mistakes

LARGEST = 1_000_000
"""Bytes of a reply, at most; a usual one has about 5,000. Reading stops there."""

_GEMINI_SAMPLING = (
    *("temperature", "top_p", "top_k", "seed", "max_output_tokens", "thinking_config"),
    *("stop_sequences", "candidate_count", "presence_penalty", "frequency_penalty"),
    *("media_resolution", "response_logprobs", "logprobs", "safety_settings"),
)


class Server:
    """A model behind a server. Nothing else decides on retries.

    ``ValueError`` for no key, or sampling settings that Gemini does not have.
    """

    def __init__(self, config: LiveConfig):
        if config.kind == "gemini":
            check_names("vlm.sampling", tuple(config.sent), _GEMINI_SAMPLING)
        self._config, self._key, self.who = config, config.read_key(), config.who

    def ask(self, request: Request) -> Reply:
        """See ``Provider``. A try that failed is followed by another where that may help."""
        c, attempts = self._config, ()
        while True:
            try:
                return replace(self._post(request), attempts=(*attempts, 200))
            except ProviderError as error:
                attempts = (*attempts, error.status)
                if not error.passing or len(attempts) == c.tries:
                    tried = f" (tried {len(attempts)} times)" if len(attempts) > 1 else ""
                    # In a line, without the key and without control characters.
                    what = printable(re.sub(r"\s+", " ", self._strike(str(error)))).strip()
                    said = f"vlm={c.kind} ({c.model}): {error.status}: {what[:300]}"
                    # Not chained: the other error may repeat the key.
                    raise ProviderError(said + tried, error.status, attempts) from None
            sleep(min(c.longest_wait, c.first_wait * 2 ** (len(attempts) - 1)))

    def close(self) -> None:
        """See ``Provider``: each try has a connection of its own, so there is nothing to do."""

    def _late(self) -> ProviderError:
        return ProviderError(f"no answer within {self._config.timeout:g} s", "timeout")

    def _post(self, request: Request) -> Reply:
        """One try.

        No redirect is followed, because the headers carry the key. No compression is accepted,
        because a few compressed bytes can hold gigabytes.
        """
        config, protocol = self._config, _PROTOCOLS[self._config.kind]
        address, header, body = protocol.request(config, request)
        until = time.monotonic() + config.timeout
        own = {} if self._key is None else {header[0]: header[1] + self._key}
        try:
            with requests.post(
                address,
                json=body,
                headers={"Accept-Encoding": "identity", **own},
                # Else a password of ~/.netrc would take the key's place.
                auth=lambda prepared: prepared,
                timeout=config.timeout,
                allow_redirects=False,
                stream=True,
            ) as response:
                found = self._body(response, until)
        except (requests.RequestException, HTTPError) as error:
            raise self._no_reply(error) from error
        if response.status_code != 200:
            raise ProviderError(_refusal(response, found), response.status_code)
        try:
            return protocol.model_validate_json(self._strike(found.decode())).reply(config.model)
        except UnicodeDecodeError as error:
            raise ProviderError("the reply is no UTF-8", "unreadable") from error
        except ValidationError as error:
            (said,) = mistakes(error)
            raise ProviderError(f"the reply is of another form: {said}", "unreadable") from error

    def _body(self, response: requests.Response, until: float) -> bytes:
        """What arrives until then, piece by piece: a byte now and then keeps each wait short."""
        if response.headers.get("Content-Encoding", "identity") != "identity":
            raise ProviderError("the reply is compressed, unasked", "unreadable")
        found = bytearray()
        while piece := response.raw.read1(65_536):
            found += piece
            if len(found) > LARGEST:
                raise ProviderError(f"the reply is larger than {LARGEST:,} bytes", "unreadable")
            if time.monotonic() > until:
                raise self._late()
        return bytes(found)

    def _no_reply(self, error: Exception) -> ProviderError:
        if isinstance(error, requests.Timeout | ReadTimeoutError):
            return self._late()
        if isinstance(error, ProtocolError) or isinstance(error.args[0], ProtocolError):
            return ProviderError("the reply is no HTTP, or broke off", "unreadable")
        cause: BaseException = error
        while cause.__context__ is not None:
            cause = cause.__context__
        return ProviderError(str(cause), "unreachable")

    def _strike(self, text: str) -> str:
        """A text without the key, even where JSON spells it with escapes, within JSON or not."""
        if self._key is None:
            return text
        spelt = (rf"\\*(?:{re.escape(letter)}|(?i:u{ord(letter):04x}))" for letter in self._key)
        return re.sub("".join(spelt), "***", text)


def _refusal(response: requests.Response, body: bytes) -> str:
    """What a server says of an error."""
    if response.is_redirect:
        return (
            f"it redirects to {response.headers['Location']!r}; the key goes nowhere unasked:"
            " give vlm.base_url if that is the server"
        )
    said = body.decode("utf-8", "replace")
    try:
        match parse_json(said):
            case {"error": {"message": str(message)}} | {"message": str(message)}:
                return message
    except UnreadableError:
        # The error is no JSON; its text is the message.
        pass
    return said


Count = Annotated[int, Field(ge=0, le=2**53)]

Posted = tuple[str, tuple[str, str], dict[str, Any]]
"""Address; the name of the key's header, and what stands before the key in it; body."""


def _at(key: str, *keys: str | int) -> Any:
    """A field that may be missing, by the keys that lead to it."""
    return Field(None, validation_alias=AliasPath(key, *keys))


class _Wanted(BaseModel):
    """What is wanted of a reply, in exact types."""

    model_config = ConfigDict(strict=True)


class _OpenAi(_Wanted):
    """Chat completions: how a request is put, and a reply's first answer read."""

    message: dict[str, Any] = Field(validation_alias=AliasPath("choices", 0, "message"))
    content: str | None = _at("choices", 0, "message", "content")
    refusal: str | None = _at("choices", 0, "message", "refusal")
    finish: str | None = _at("choices", 0, "finish_reason")
    model: str | None = None
    usage: dict[str, Any] | None = None
    tokens_in: Count | None = _at("usage", "prompt_tokens")
    tokens_out: Count | None = _at("usage", "completion_tokens")

    @staticmethod
    def request(config: LiveConfig, request: Request) -> Posted:
        def piece(part: Part) -> dict[str, Any]:
            if isinstance(part, str):
                return {"type": "text", "text": part}
            url = f"data:image/png;base64,{base64.b64encode(part.png).decode()}"
            return {"type": "image_url", "image_url": {"url": url}}

        messages = [
            {"role": "assistant", "content": "".join(map(str, message.parts))}
            if message.role == "assistant"
            else {"role": "user", "content": [piece(part) for part in message.parts]}
            for message in request.messages
        ]
        form = {"name": "answer", "schema": dict(request.schema), "strict": True}
        body = {
            "model": config.model,
            "messages": messages,
            "response_format": {"type": "json_schema", "json_schema": form},
            # Sent unchecked: servers differ in the settings that they take.
            **config.sent,
        }
        base = config.base_url or "https://api.openai.com/v1"
        return f"{base.rstrip('/')}/chat/completions", ("Authorization", "Bearer "), body

    def reply(self, model: str) -> Reply:
        refusal = self.refusal or (self.finish if self.finish == "content_filter" else None)
        said = _outcome(self.content or "", refusal, self.finish, self.finish == "length")
        return Reply(*said, self.model or model, self.tokens_in, self.tokens_out)


class _Piece(_Wanted):
    text: str | None = None
    thought: bool | None = None


class _Gemini(_Wanted):
    """``generateContent``: how a request is put, and a reply's first answer read."""

    candidates: list[dict[str, Any]] | None = None
    content: dict[str, Any] | None = _at("candidates", 0, "content")
    parts: list[_Piece] | None = _at("candidates", 0, "content", "parts")
    finish: str | None = _at("candidates", 0, "finishReason")
    blocked: str | None = _at("promptFeedback", "blockReason")
    model: str | None = _at("modelVersion")
    usage: dict[str, Any] | None = _at("usageMetadata")
    tokens_in: Count | None = _at("usageMetadata", "promptTokenCount")
    tokens_out: Count | None = _at("usageMetadata", "candidatesTokenCount")
    thoughts: Count | None = _at("usageMetadata", "thoughtsTokenCount")

    @staticmethod
    def request(config: LiveConfig, request: Request) -> Posted:
        def piece(part: Part) -> dict[str, Any]:
            if isinstance(part, str):
                return {"text": part}
            data = base64.b64encode(part.png).decode()
            return {"inlineData": {"mimeType": "image/png", "data": data}}

        contents = [
            {
                "role": "model" if message.role == "assistant" else "user",
                "parts": [piece(part) for part in message.parts],
            }
            for message in request.messages
        ]
        sampling = {to_camel(name): value for name, value in config.sent.items()}
        # Of all that may be set, this alone stands beside the others.
        safety = {key: sampling.pop(key) for key in ("safetySettings",) if key in sampling}
        form = {"responseMimeType": "application/json", "responseJsonSchema": dict(request.schema)}
        body = {"contents": contents, "generationConfig": {**sampling, **form}, **safety}
        base = config.base_url or "https://generativelanguage.googleapis.com"
        model = config.model if "/" in config.model else f"models/{config.model}"
        address = f"{base.rstrip('/')}/v1/{model}:generateContent"
        return address, ("x-goog-api-key", ""), body

    def reply(self, model: str) -> Reply:
        text = "".join(p.text for p in self.parts or () if p.text and not p.thought)
        is_cut = self.finish in ("MAX_TOKENS", "CONTINUATION")
        filtered = None if is_cut or self.finish == "STOP" else self.finish
        said = _outcome(text, self.blocked or filtered, self.finish, is_cut)
        # Thoughts are billed as output.
        out = None if self.tokens_out is None else self.tokens_out + (self.thoughts or 0)
        return Reply(*said, self.model or model, self.tokens_in, out)


_PROTOCOLS = {"gemini": _Gemini, "openai": _OpenAi}


def _outcome(
    text: str, refusal: str | None, finish: str | None, is_cut: bool
) -> tuple[str, str, str]:
    """A reply's outcome, answer and detail; ``finish``: why it ended, in the server's words."""
    if refusal:
        return "refused", text, refusal
    if not text.strip():
        return "empty", text, finish or "no reason was given"
    return ("truncated", text, finish or "") if is_cut else ("answered", text, "")
