"""Google's Gemini, through google-genai."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from needlehoop.vlm.messages import Message, Request
from needlehoop.vlm.providers.contract import LiveConfig, Reply, lacking
from needlehoop.vlm.providers.sdk import SdkProvider

if TYPE_CHECKING:
    from google import genai
    from google.genai import types


class Gemini(SdkProvider):
    """Asks ``generate_content``.

    Args:
        config: whom to ask and how.

    Raises:
        ValueError: no key, or sampling settings that Gemini does not have.
        RuntimeError: google-genai is not installed.
    """

    def __init__(self, config: LiveConfig):
        try:
            from google import genai
        except ImportError as error:
            raise lacking("gemini", "google-genai") from error
        super().__init__(config)
        self._genai = genai
        known = set(genai.types.GenerateContentConfig.model_fields)
        for name in config.sent:
            if name not in known:
                valid = "temperature, top_p, top_k, seed, max_output_tokens, thinking_config"
                raise ValueError(f"vlm.sampling: unknown key {name!r}; choose from {valid}, …")

    def _connect(self) -> genai.Client:
        # Without retry_options it tries once.
        options = self._genai.types.HttpOptions(
            base_url=self._config.base_url, timeout=round(1000 * self._config.timeout)
        )
        return self._genai.Client(api_key=self._key or "none", vertexai=False, http_options=options)

    def _send(self, request: Request) -> Reply:
        types = self._genai.types
        options = types.GenerateContentConfig(
            **self._config.sent,
            response_mime_type="application/json",
            response_json_schema=dict(request.schema),
        )
        contents: list[Any] = [self._content(message) for message in request.messages]
        response = self._client.models.generate_content(
            model=self._config.model, contents=contents, config=options
        )
        return _reply(response, self._config.model)

    def _content(self, message: Message) -> types.Content:
        part = self._genai.types.Part
        parts = [
            part.from_text(text=piece)
            if isinstance(piece, str)
            else part.from_bytes(data=piece.png, mime_type="image/png")
            for piece in message.parts
        ]
        role = "model" if message.role == "assistant" else "user"
        return self._genai.types.Content(role=role, parts=parts)

    def _status(self, error: Exception) -> tuple[int | str, str] | None:
        import httpx2

        if isinstance(error, self._genai.errors.APIError):
            return error.code, error.message or str(error)
        if isinstance(error, httpx2.TimeoutException):
            return "timeout", ""
        if isinstance(error, httpx2.TransportError):
            return "unreachable", str(error)
        # The SDK reports a body that is no JSON by a subclass of ValueError of its own.
        if isinstance(error, json.JSONDecodeError | self._genai.errors.UnknownApiResponseError):
            return "unreadable", "the reply is no JSON"
        return None


def _reply(response: types.GenerateContentResponse, asked: str) -> Reply:
    """The first candidate; anything but a stop or a full page is a filter's work."""
    usage, feedback = response.usage_metadata, response.prompt_feedback
    candidate = response.candidates[0] if response.candidates else None
    parts = (candidate.content.parts or []) if candidate and candidate.content else []
    text = "".join(part.text for part in parts if part.text and not part.thought)
    detail = ""
    if candidate is None:
        block = feedback.block_reason if feedback else None
        outcome = "refused" if block else "empty"
        detail = str(block.value) if block else "no candidates"
    else:
        finish = str(candidate.finish_reason.value) if candidate.finish_reason else "STOP"
        if finish not in ("STOP", "MAX_TOKENS", "CONTINUATION"):
            outcome, detail = "refused", finish
        elif not text.strip():
            outcome, detail = "empty", finish
        elif finish == "STOP":
            outcome = "answered"
        else:
            outcome, detail = "truncated", finish
    spent = None
    if usage and usage.candidates_token_count is not None:
        # Thoughts are paid for as output.
        spent = usage.candidates_token_count + (usage.thoughts_token_count or 0)
    return Reply(
        outcome=outcome,
        answer=text,
        detail=detail,
        model=response.model_version or asked,
        tokens_in=usage.prompt_token_count if usage else None,
        tokens_out=spent,
    )
