"""Google's Gemini, through google-genai."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needlehoop.vlm.messages import Message, Request
from needlehoop.vlm.providers.contract import LiveConfig, Reply, lacking
from needlehoop.vlm.providers.sdk import SdkProvider
from needlehoop.vlm.providers.wire import Count, ReplyPart, read_reply

if TYPE_CHECKING:
    from google import genai
    from google.genai import types


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

    def _http_client(self) -> type[Any]:
        import httpx2

        return httpx2.Client

    def _connect(self, http: Any) -> genai.Client:
        # Without retry_options it tries once.
        options = self._genai.types.HttpOptions(
            base_url=self._config.base_url,
            timeout=round(1000 * self._config.timeout),
            httpx_client=http,
        )
        return self._genai.Client(api_key=self._key or "none", vertexai=False, http_options=options)

    def _send(self, request: Request) -> Reply:
        types = self._genai.types
        options = types.GenerateContentConfig(
            **self._config.sent,
            response_mime_type="application/json",
            response_json_schema=dict(request.schema),
            # The reply is read here: the SDK accepts much that is no valid reply.
            should_return_http_response=True,
        )
        contents: list[Any] = [self._content(message) for message in request.messages]
        response = self._client.models.generate_content(
            model=self._config.model, contents=contents, config=options
        )
        body = response.sdk_http_response.body or ""
        return _reply(read_reply(body.encode(), _Response, self._key), self._config.model)

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
        return None


def _reply(response: _Response, asked: str) -> Reply:
    """The first candidate. A finish other than a stop or a full page is a filter's."""
    usage, feedback = response.usage_metadata, response.prompt_feedback
    candidate = response.candidates[0] if response.candidates else None
    parts = (candidate.content.parts or []) if candidate and candidate.content else []
    text = "".join(part.text for part in parts if part.text and not part.thought)
    detail = ""
    if candidate is None:
        block = feedback.block_reason if feedback else None
        outcome = "refused" if block else "empty"
        detail = block if block else "no candidates"
    else:
        finish = candidate.finish_reason or "STOP"
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
        # Thoughts are billed as output.
        spent = usage.candidates_token_count + (usage.thoughts_token_count or 0)
    return Reply(
        outcome=outcome,
        answer=text,
        detail=detail,
        model=response.model_version or asked,
        tokens_in=usage.prompt_token_count if usage else None,
        tokens_out=spent,
    )
