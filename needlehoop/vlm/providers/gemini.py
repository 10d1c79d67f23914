"""Google's Gemini, through google-genai."""

from __future__ import annotations

from typing import Any

from needlehoop.vlm.messages import Message, Request
from needlehoop.vlm.providers.contract import LiveConfig, Reply
from needlehoop.vlm.providers.sdk import (
    Count,
    ReplyPart,
    SdkProvider,
    careful,
    outcome,
    read_reply,
)

_WHOLE, _CUT = "STOP", ("MAX_TOKENS", "CONTINUATION")
"""Finishes of an answer; any other is a filter's."""


class _Piece(ReplyPart):
    text: str | None = None
    thought: bool | None = None


class _Content(ReplyPart):
    parts: list[_Piece] | None = None


class _Candidate(ReplyPart):
    content: _Content | None = None
    finish_reason: str | None = None


class _Feedback(ReplyPart):
    block_reason: str | None = None


class _Usage(ReplyPart):
    prompt_token_count: Count | None = None
    candidates_token_count: Count | None = None
    thoughts_token_count: Count | None = None


class _Response(ReplyPart):
    candidates: list[_Candidate] | None = None
    prompt_feedback: _Feedback | None = None
    usage_metadata: _Usage | None = None
    model_version: str | None = None


class Gemini(SdkProvider):
    """Asks ``generate_content``; errors as in ``SdkProvider``.

    Raises:
        ValueError: sampling settings that Gemini does not have.
    """

    def __init__(self, config: LiveConfig):
        super().__init__(config, "google-genai", "google.genai")
        import httpx2

        types = self._sdk.types
        for name in config.sent:
            if name not in types.GenerateContentConfig.model_fields:
                valid = "temperature, top_p, top_k, seed, max_output_tokens, thinking_config"
                raise ValueError(f"vlm.sampling: unknown key {name!r}; choose from {valid}, …")
        self._http = careful(httpx2.Client, config.timeout)
        # Without retry_options it tries once.
        options = types.HttpOptions(
            base_url=config.base_url,
            timeout=round(1000 * config.timeout),
            httpx_client=self._http,
        )
        self._client = self._sdk.Client(
            api_key=self._key or "none", vertexai=False, http_options=options
        )

    def _send(self, request: Request) -> Reply:
        options = self._sdk.types.GenerateContentConfig(
            **self._config.sent,
            response_mime_type="application/json",
            response_json_schema=dict(request.schema),
            # The reply is read here: the SDK accepts much that is no valid reply.
            should_return_http_response=True,
        )
        response = self._client.models.generate_content(
            model=self._config.model,
            contents=[self._content(message) for message in request.messages],
            config=options,
        )
        body = response.sdk_http_response.body or ""
        return _reply(read_reply(body, _Response, self._key), self._config.model)

    def _content(self, message: Message) -> Any:
        part = self._sdk.types.Part
        parts = [
            part.from_text(text=piece)
            if isinstance(piece, str)
            else part.from_bytes(data=piece.png, mime_type="image/png")
            for piece in message.parts
        ]
        role = "model" if message.role == "assistant" else "user"
        return self._sdk.types.Content(role=role, parts=parts)


def _reply(response: _Response, asked: str) -> Reply:
    """The first candidate."""
    usage, feedback = response.usage_metadata, response.prompt_feedback
    candidate = response.candidates[0] if response.candidates else None
    parts = (candidate.content.parts or []) if candidate and candidate.content else []
    text = "".join(part.text for part in parts if part.text and not part.thought)
    if candidate is None:
        finish, refusal = "no candidates", feedback.block_reason if feedback else None
    else:
        finish = candidate.finish_reason or _WHOLE
        refusal = None if finish in (_WHOLE, *_CUT) else finish
    what, detail = outcome(text, refusal, finish, finish in _CUT)
    spent = None
    if usage and usage.candidates_token_count is not None:
        # Thoughts are billed as output.
        spent = usage.candidates_token_count + (usage.thoughts_token_count or 0)
    tokens = usage.prompt_token_count if usage else None
    return Reply(what, text, detail, response.model_version or asked, tokens, spent)
