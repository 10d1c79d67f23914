"""Who answers: models behind servers (Gemini's or OpenAI's protocol), or a person by hand.

The servers' SDKs try again by themselves after 408, 429, 5xx, time-outs and broken connections.
"""

from __future__ import annotations

import base64
import json
import re
import sys
import time
from itertools import count
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from needlehoop.config.strict import check_names
from needlehoop.runs.files import write_whole
from needlehoop.runs.machine import import_extra
from needlehoop.vlm.config import LiveConfig, ManualConfig
from needlehoop.vlm.messages import (
    Message,
    Part,
    Provider,
    ProviderError,
    Reply,
    Request,
    mistakes,
)

_NO_KEY = "none"
"""Sent to a server without keys. Without it the SDKs take a key from variables of their own."""

ANSWERS = ("answer.json", "answer.md", "answer.txt")
"""Names that the file of a person's answer may have."""

_GUIDE = """\
Give a vision-language model what stands below the line, with each picture at the place that
names it. Save what it answers in this folder: as answer.json, or all that it said as answer.md.
"""


def provider_of(config: LiveConfig | ManualConfig, folder: Path) -> Provider:
    """Who answers; ``folder``: the study's, where questions to a person are put.

    ``ValueError``: the SDK is not installed, there is no key, or Gemini lacks a sampling setting.
    """
    if isinstance(config, ManualConfig):
        return Manual(config, folder)
    return {"gemini": Gemini, "openai": OpenAi}[config.kind](config)


class LiveProvider:
    """A model behind a server; see ``Provider``."""

    _package: str
    _cut: str
    """The reason that a model gives where it ends at the limit of length."""

    def __init__(self, config: LiveConfig):
        self._config, self._key = config, config.read_key()
        self.who = {"provider": config.kind, "model": config.model, "sampling": config.sent}
        self._sdk = import_extra(self._package, f"vlm={config.kind}", config.kind)

    def ask(self, request: Request) -> Reply:
        """The reply; ``ProviderError`` if there is none after all tries."""
        try:
            return self._ask(request)
        # An SDK lets the errors of its HTTP library and of parsing through, beside its own.
        except Exception as error:
            status = getattr(error, "status_code", getattr(error, "code", None))
            status = status if isinstance(status, int) else type(error).__name__
            label = f"vlm={self._config.kind} ({self._config.model})"
            message = str(error.__cause__ or error)
            if self._key:
                message = message.replace(self._key, "***")
            message = " ".join(message.split())[:300]
            # Not chained, because the other error may repeat the key.
            raise ProviderError(f"{label}: {status}: {message}", status) from None

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
        return Reply(outcome, text, detail, model or self._config.model, *tokens, attempts=(200,))


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
        completion = self._client.chat.completions.create(
            model=self._config.model,
            messages=[self._message(message) for message in request.messages],
            response_format={"type": "json_schema", "json_schema": form},
            # Not checked, because servers differ in the settings that they take.
            extra_body=self._config.sent,
        )
        choice, usage = completion.choices[0], completion.usage
        finish, text = choice.finish_reason, choice.message.content or ""
        refusal = choice.message.refusal or (finish if finish == "content_filter" else None)
        tokens = (usage.prompt_tokens, usage.completion_tokens) if usage else (None, None)
        return self._reply(text, refusal, finish, completion.model, tokens)

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
        response = self._client.models.generate_content(
            model=self._config.model,
            contents=[self._content(message) for message in request.messages],
            config=self._settings.model_copy(update=form),
        )
        # A filter leaves out the candidate or its parts.
        reason = response.candidates[0].finish_reason if response.candidates else None
        block = response.prompt_feedback and response.prompt_feedback.block_reason
        finish, blocked = reason and reason.value, block and block.value
        refusal = blocked or (None if finish in (self._cut, "STOP") else finish)
        usage = response.usage_metadata
        tokens = (usage.prompt_token_count, usage.candidates_token_count) if usage else (None, None)
        if tokens[1] is not None:
            # Thoughts are billed as output.
            tokens = (tokens[0], tokens[1] + (usage.thoughts_token_count or 0))
        return self._reply(response.text or "", refusal, finish, response.model_version, tokens)

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


class UnansweredError(RuntimeError):
    """Nobody answered in time. Nothing is recorded."""


class Manual:
    """Writes each request into a folder of the study's record and waits for an answer there."""

    def __init__(self, config: ManualConfig, folder: Path):
        self._config, self._folder = config, folder
        self.who = {"provider": config.kind, "model": config.model, "sampling": {}}

    def ask(self, request: Request) -> Reply:
        """The answer, once its file is there; ``UnansweredError`` when the time to wait is over."""
        place = self._folder / "asked" / request.sha256[:16]
        write_request(request, place)
        answer = find_json(self._wait(place))
        # Moved away, because the same question may be asked again.
        done = self._folder / "answered"
        done.mkdir(parents=True, exist_ok=True)
        free = next(n for n in count(1) if not any(done.glob(f"{n:03d}_*")))
        place.rename(done / f"{free:03d}_{place.name}")
        return Reply("answered", answer, "", self._config.model, None, None, ("by hand",))

    def _wait(self, place: Path) -> str:
        """What is in the answer's file, which must not be empty; of several the first name's."""
        config, began, before = self._config, time.monotonic(), ""
        if not any((place / name).is_file() for name in ANSWERS):
            print(
                f"vlm=manual: give {place / 'request.md'} and its pictures to {config.model}, and"
                f" save the answer beside it as {ANSWERS[0]} (as it is: {ANSWERS[1]}); Ctrl-C"
                " stops, and the same command goes on",
                file=sys.stderr,
                flush=True,
            )
        while True:
            path = next((place / name for name in ANSWERS if (place / name).is_file()), None)
            answer = path.read_text("utf-8-sig").strip() if path else ""
            # It has not changed since the last look, so nobody is still writing it.
            if answer and answer == before:
                return answer
            if not answer and config.wait is not None and time.monotonic() - began >= config.wait:
                raise UnansweredError(
                    f"{place}: no answer yet; put it there, and the same command goes on"
                )
            before = answer
            time.sleep(config.poll)


def write_request(request: Request, place: Path) -> None:
    """``schema.json``, pictures ``01.png``, … and, last, ``request.md``, in a folder made here."""
    # The pictures of all turns are numbered through.
    numbers = count(1)

    def put(part: Part) -> str:
        if isinstance(part, str):
            return f"{part}\n"
        name = f"{next(numbers):02d}.png"
        write_whole(place / name, part.png)
        return f"[picture {name}]\n"

    turns = [[put(part) for part in message.parts] for message in request.messages]
    schema = json.dumps(request.schema, indent=2, ensure_ascii=False)
    write_whole(place / "schema.json", schema + "\n")
    lines = [_GUIDE, "---\n"]
    if len(turns) > 1:
        remember = "What was said before is needed where the model does not remember it.\n"
        lines = [_GUIDE, remember, "---\n", "# What was said before\n"]
        for message, turn in zip(request.messages[:-1], turns, strict=False):
            is_answer = message.role == "assistant"
            lines += ["## The model answered\n" if is_answer else "## It was asked\n", *turn]
        lines += ["# What is asked now\n"]
    form = "Answer with one JSON object of this schema, and nothing else:\n\n"
    lines += [*turns[-1], f"{form}```json\n{schema}\n```\n"]
    write_whole(place / "request.md", "\n".join(lines))


def find_json(answer: str) -> str:
    """The JSON object in a model's text: all of it, in a fence, or between braces.

    A text without one is returned as it is, to be refused like any malformed answer.
    """
    fenced = re.findall(r"^```\w*[ \t]*\n(.*?)^```", answer, re.DOTALL | re.MULTILINE)
    braces = answer[answer.find("{") : answer.rfind("}") + 1]
    for text in (answer, *reversed(fenced), braces):
        try:
            if isinstance(json.loads(text), dict):
                return text.strip()
        except (ValueError, RecursionError):
            continue
    return answer
