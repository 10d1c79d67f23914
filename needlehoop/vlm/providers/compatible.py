"""Any server with OpenAI's chat completions: OpenAI, vLLM, Ollama, …"""

from __future__ import annotations

import base64
from typing import Any

from pydantic import ConfigDict, Field

from needlehoop.vlm.messages import Message, Part, Request
from needlehoop.vlm.providers.contract import LiveConfig, Reply
from needlehoop.vlm.providers.sdk import (
    Count,
    ReplyPart,
    SdkProvider,
    careful,
    outcome,
    read_reply,
)


class _Part(ReplyPart):
    model_config = ConfigDict(alias_generator=None)


class _Message(_Part):
    content: str | None = None
    refusal: str | None = None


class _Choice(_Part):
    message: _Message
    finish_reason: str | None = None


class _Usage(_Part):
    prompt_tokens: Count | None = None
    completion_tokens: Count | None = None


class _Completion(_Part):
    choices: list[_Choice] = Field(min_length=1)
    model: str | None = None
    usage: _Usage | None = None


class Compatible(SdkProvider):
    """Asks ``chat.completions``; errors as in ``SdkProvider``."""

    def __init__(self, config: LiveConfig):
        super().__init__(config, "openai", "openai")
        self._http = careful(self._sdk.DefaultHttpxClient, config.timeout)
        self._client = self._sdk.OpenAI(
            api_key=self._key or "none",
            base_url=config.base_url,
            timeout=config.timeout,
            max_retries=0,
            http_client=self._http,
        )

    def _send(self, request: Request) -> Reply:
        form = {"name": "answer", "schema": dict(request.schema), "strict": True}
        raw = self._client.chat.completions.with_raw_response.create(
            model=self._config.model,
            messages=[_message(message) for message in request.messages],
            response_format={"type": "json_schema", "json_schema": form},
            # Sent unchecked: servers differ in the settings that they take.
            extra_body=self._config.sent,
        )
        return _reply(read_reply(raw.text, _Completion, self._key), self._config.model)


def _message(message: Message) -> dict[str, Any]:
    if message.role == "assistant":
        return {"role": "assistant", "content": "".join(map(str, message.parts))}
    return {"role": "user", "content": [_piece(part) for part in message.parts]}


def _piece(part: Part) -> dict[str, Any]:
    if isinstance(part, str):
        return {"type": "text", "text": part}
    data = base64.b64encode(part.png).decode()
    return {"type": "image_url", "image_url": {"url": f"data:image/png;base64,{data}"}}


def _reply(completion: _Completion, asked: str) -> Reply:
    """The first choice."""
    choice, usage = completion.choices[0], completion.usage
    text, finish = choice.message.content or "", choice.finish_reason
    refusal = choice.message.refusal or (finish if finish == "content_filter" else None)
    what, detail = outcome(text, refusal, finish or "no reason", finish == "length")
    return Reply(
        what,
        text,
        detail,
        completion.model or asked,
        usage.prompt_tokens if usage else None,
        usage.completion_tokens if usage else None,
    )
