"""Models behind servers, asked through SDKs: Google's Gemini, and any OpenAI-compatible server.

The SDKs try again by themselves after 408, 429, 5xx, time-outs and broken connections.
"""

from __future__ import annotations

import base64
from importlib import import_module
from typing import Any

from pydantic import ValidationError

from needlehoop.config.strict import check_names
from needlehoop.vlm.config import LiveConfig
from needlehoop.vlm.messages import Message, Part, ProviderError, Reply, Request, mistakes

_NO_KEY = "none"
"""Sent to a server without keys. Without it the SDKs take a key from variables of their own."""


def live_provider(config: LiveConfig) -> LiveProvider:
    """The provider of ``vlm=gemini`` or ``vlm=openai``.

    ``ValueError``: the SDK is not installed, there is no key, or Gemini lacks a sampling setting.
    """
    return {"gemini": Gemini, "openai": OpenAi}[config.kind](config)


class LiveProvider:
    """A model behind a server; see ``Provider``."""

    _package: str
    _cut: str
    """Why a model ends at the limit of length."""

    def __init__(self, config: LiveConfig):
        self._config, self._key = config, config.read_key()
        self.who = {"provider": config.kind, "model": config.model, "sampling": config.sent}
        try:
            self._sdk: Any = import_module(self._package)
        except ImportError as error:
            raise ValueError(
                f"vlm={config.kind} needs {self._package}: pip install 'needlehoop[{config.kind}]'"
            ) from error

    def ask(self, request: Request) -> Reply:
        """The reply; ``ProviderError`` if there is none after all tries."""
        config = self._config
        try:
            return self._ask(request)
        # An SDK lets the errors of its HTTP library and of parsing through, beside its own.
        except Exception as error:
            status = getattr(error, "status_code", getattr(error, "code", None))
            status = status if isinstance(status, int) else type(error).__name__
            said = " ".join(self._strike(str(error.__cause__ or error)).split())[:300]
            # Not chained, because the other error may repeat the key.
            raise ProviderError(
                f"vlm={config.kind} ({config.model}): {status}: {said}", status
            ) from None

    def _ask(self, request: Request) -> Reply:
        raise NotImplementedError

    def _reply(
        self,
        text: str,
        refusal: str | None,
        finish: str | None,
        model: str | None,
        tokens: tuple[int | None, int | None],
    ) -> Reply:
        """``finish`` is why the model ended, and ``refusal`` why it refused, if it did."""
        outcome, detail = "answered", ""
        if refusal:
            outcome, detail = "refused", refusal
        elif not text.strip():
            outcome, detail = "empty", finish or "no reason was given"
        elif finish == self._cut:
            outcome, detail = "truncated", self._cut
        answer, detail, model = map(self._strike, (text, detail, model or self._config.model))
        return Reply(outcome, answer, detail, model, *tokens, attempts=(200,))

    def _strike(self, text: str) -> str:
        """A text without the key: a server may repeat it."""
        return text.replace(self._key, "***") if self._key else text


class OpenAi(LiveProvider):
    """OpenAI's chat completions, which Ollama and vLLM serve too."""

    _package, _cut = "openai", "length"

    def __init__(self, config: LiveConfig):
        super().__init__(config)
        self._client = self._sdk.OpenAI(
            api_key=self._key or _NO_KEY,
            base_url=config.base_url,
            timeout=config.timeout,
            max_retries=config.tries - 1,
        )

    def _ask(self, request: Request) -> Reply:
        form = {"name": "answer", "schema": dict(request.schema), "strict": True}
        found = self._client.chat.completions.create(
            model=self._config.model,
            messages=[self._message(message) for message in request.messages],
            response_format={"type": "json_schema", "json_schema": form},
            # Not checked, because servers differ in the settings that they take.
            extra_body=self._config.sent,
        )
        choice, usage = found.choices[0], found.usage
        finish, text = choice.finish_reason, choice.message.content or ""
        refusal = choice.message.refusal or (finish if finish == "content_filter" else None)
        tokens = (usage.prompt_tokens, usage.completion_tokens) if usage else (None, None)
        return self._reply(text, refusal, finish, found.model, tokens)

    def _message(self, message: Message) -> dict[str, Any]:
        def piece(part: Part) -> dict[str, Any]:
            if isinstance(part, str):
                return {"type": "text", "text": part}
            url = f"data:image/png;base64,{base64.b64encode(part.png).decode()}"
            return {"type": "image_url", "image_url": {"url": url}}

        if message.role == "assistant":
            return {"role": "assistant", "content": "".join(map(str, message.parts))}
        return {"role": "user", "content": [piece(part) for part in message.parts]}


class Gemini(LiveProvider):
    """Google's Gemini."""

    _package, _cut = "google.genai", "MAX_TOKENS"

    def __init__(self, config: LiveConfig):
        super().__init__(config)
        self._types = types = self._sdk.types
        settings = types.GenerateContentConfig
        check_names("vlm.sampling", tuple(config.sent), tuple(settings.model_fields))
        try:
            self._settings = settings(**config.sent, response_mime_type="application/json")
        except ValidationError as error:
            raise ValueError(f"vlm.sampling: {mistakes(error)}") from error
        http = types.HttpOptions(
            base_url=config.base_url,
            timeout=round(1000 * config.timeout),
            retry_options=types.HttpRetryOptions(attempts=config.tries),
        )
        key = self._key or _NO_KEY
        self._client = self._sdk.Client(api_key=key, vertexai=False, http_options=http)

    def _ask(self, request: Request) -> Reply:
        form = {"response_json_schema": dict(request.schema)}
        found = self._client.models.generate_content(
            model=self._config.model,
            contents=[self._content(message) for message in request.messages],
            config=self._settings.model_copy(update=form),
        )
        text, finish, blocked = "", None, None
        # A filter leaves out the candidate or its parts.
        if found.candidates:
            content, reason = found.candidates[0].content, found.candidates[0].finish_reason
            parts, finish = (content and content.parts) or (), reason and reason.value
            text = "".join(part.text for part in parts if part.text and not part.thought)
        if found.prompt_feedback and found.prompt_feedback.block_reason:
            blocked = found.prompt_feedback.block_reason.value
        refusal = blocked or (None if finish in (self._cut, "STOP") else finish)
        usage = found.usage_metadata
        tokens = (usage.prompt_token_count, usage.candidates_token_count) if usage else (None, None)
        if tokens[1] is not None:
            # Thoughts are billed as output.
            tokens = (tokens[0], tokens[1] + (usage.thoughts_token_count or 0))
        return self._reply(text, refusal, finish, found.model_version, tokens)

    def _content(self, message: Message) -> Any:
        make = self._types.Part
        return self._types.Content(
            role="model" if message.role == "assistant" else "user",
            parts=[
                make.from_text(text=part)
                if isinstance(part, str)
                else make.from_bytes(data=part.png, mime_type="image/png")
                for part in message.parts
            ],
        )
