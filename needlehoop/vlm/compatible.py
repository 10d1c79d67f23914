"""Any server that speaks OpenAI's chat completions: OpenAI, vLLM, Ollama, …"""

from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING, Any

from needlehoop.vlm.messages import Message, Part, Request
from needlehoop.vlm.provider import LiveConfig, ProviderError, Reply, failure, lacking

if TYPE_CHECKING:
    import openai
    from openai.types.chat import ChatCompletion


class Compatible:
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
        self._openai = openai
        self._config = config
        self._key = config.read_key()
        self._client: openai.OpenAI | None = None

    def ask(self, request: Request) -> Reply:
        """See ``Provider``."""
        messages: list[Any] = [_message(message) for message in request.messages]
        form: Any = {"name": "answer", "schema": dict(request.schema), "strict": True}
        try:
            completion = self._connect().chat.completions.create(
                model=self._config.model,
                messages=messages,
                response_format={"type": "json_schema", "json_schema": form},
                # In the body as they are: servers differ in what they take.
                extra_body=self._config.sent,
            )
        except Exception as error:
            known = self._explain(error)
            if known is None:
                raise
            # The SDK's own error may carry what the server said of the key.
            raise known from None
        if not getattr(completion, "choices", None):
            raise failure(self._config, self._key, "unreadable", "the reply has no choices")
        return _reply(completion, self._config.model)

    def close(self) -> None:
        """See ``Provider``."""
        if self._client is not None:
            self._client.close()

    def _connect(self) -> openai.OpenAI:
        if self._client is None:
            self._client = self._openai.OpenAI(
                api_key=self._key or "none",
                base_url=self._config.base_url,
                timeout=self._config.timeout,
                # The policy is in retries.py alone.
                max_retries=0,
            )
        return self._client

    def _explain(self, error: Exception) -> ProviderError | None:
        """The SDK's errors in our terms; ``None`` for what is no failure to communicate."""
        sdk = self._openai
        if isinstance(error, sdk.APIStatusError):
            return failure(self._config, self._key, error.status_code, error.message)
        if isinstance(error, sdk.APITimeoutError):
            said = f"no answer within {self._config.timeout:g} s"
            return failure(self._config, self._key, "timeout", said)
        if isinstance(error, sdk.APIConnectionError):
            return failure(self._config, self._key, "unreachable", str(error.__cause__ or error))
        if isinstance(error, sdk.APIResponseValidationError | json.JSONDecodeError):
            return failure(self._config, self._key, "unreadable", "the reply is no JSON")
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


def _reply(completion: ChatCompletion, asked: str) -> Reply:
    choice, usage = completion.choices[0], completion.usage
    text, refusal = choice.message.content or "", choice.message.refusal
    if refusal or choice.finish_reason == "content_filter":
        outcome, detail = "refused", refusal or "content_filter"
    elif not text.strip():
        outcome, detail = "empty", str(choice.finish_reason)
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
