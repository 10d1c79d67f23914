"""Any server with OpenAI's chat completions: OpenAI, vLLM, Ollama, …"""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

from pydantic import ConfigDict, Field

from needlehoop.vlm.messages import Message, Part, Request
from needlehoop.vlm.providers.contract import LiveConfig, Reply, lacking
from needlehoop.vlm.providers.sdk import SdkProvider
from needlehoop.vlm.providers.wire import Count, ReplyPart, read_reply

if TYPE_CHECKING:
    import openai


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
    """Asks ``chat.completions``.

    Args:
        config: whom to ask and how.

    Raises:
        ValueError: no key.
        RuntimeError: openai is not installed.
    """

    def __init__(self, config: LiveConfig):
        try:
            import openai
        except ImportError as error:
            raise lacking("openai", "openai") from error
        super().__init__(config)
        self._openai = openai

    def _http_client(self) -> type[Any]:
        return self._openai.DefaultHttpxClient

    def _connect(self, http: Any) -> openai.OpenAI:
        return self._openai.OpenAI(
            api_key=self._key or "none",
            base_url=self._config.base_url,
            timeout=self._config.timeout,
            max_retries=0,
            http_client=http,
        )

    def _send(self, request: Request) -> Reply:
        messages: list[Any] = [_message(message) for message in request.messages]
        form: Any = {"name": "answer", "schema": dict(request.schema), "strict": True}
        raw = self._client.chat.completions.with_raw_response.create(
            model=self._config.model,
            messages=messages,
            response_format={"type": "json_schema", "json_schema": form},
            # Sent unchecked: servers differ in the settings that they take.
            extra_body=self._config.sent,
        )
        return _reply(read_reply(raw.content, _Completion, self._key), self._config.model)

    def _status(self, error: Exception) -> tuple[int | str, str] | None:
        sdk = self._openai
        if isinstance(error, sdk.APIStatusError):
            return error.status_code, error.message
        if isinstance(error, sdk.APITimeoutError):
            return "timeout", ""
        if isinstance(error, sdk.APIConnectionError):
            return "unreachable", str(error.__cause__ or error)
        return None


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
    choice, usage = completion.choices[0], completion.usage
    text, refusal = choice.message.content or "", choice.message.refusal
    if refusal or choice.finish_reason == "content_filter":
        outcome, detail = "refused", refusal or "content_filter"
    elif not text.strip():
        outcome, detail = "empty", choice.finish_reason or "no reason"
    elif choice.finish_reason == "length":
        outcome, detail = "truncated", "length"
    else:
        outcome, detail = "answered", ""
    return Reply(
        outcome=outcome,
        answer=text,
        detail=detail,
        model=completion.model or asked,
        tokens_in=usage.prompt_tokens if usage else None,
        tokens_out=usage.completion_tokens if usage else None,
    )
