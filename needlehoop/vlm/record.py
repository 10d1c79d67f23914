"""The record of all that was asked and answered; a new question goes through it to the model."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from needlehoop.runs.files import write_whole
from needlehoop.runs.run import Run
from needlehoop.vlm.config import TRANSCRIPT
from needlehoop.vlm.messages import Png, Provider, ProviderError, Reply, Request, mistakes

IMAGES = "images"


class Exchange(BaseModel):
    """One canonical request and its reply; ``outcome`` to ``attempts`` are as in ``Reply``.

    ``sha256`` is the request's; ``model`` the one asked for; ``seconds`` the time of all tries;
    ``time`` the start of the first (UTC); ``conversation`` is ``question``, ``rank``, ``rank/2``,
    ``reward/text`` or ``reward/<cameras>/image``.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    sha256: str
    conversation: str
    request: dict[str, Any]
    provider: str
    model: str
    sampling: dict[str, Any]
    outcome: str
    answer: str
    detail: str
    answered_by: str | None
    tokens_in: int | None
    tokens_out: int | None
    attempts: tuple[int | str, ...]
    seconds: float
    time: str

    @property
    def usable(self) -> bool:
        """Whether the model gave an answer that a conversation can go on from."""
        return self.outcome in ("answered", "truncated")

    @property
    def who(self) -> dict[str, Any]:
        """Who was asked and how, as ``Provider.who``."""
        return {"provider": self.provider, "model": self.model, "sampling": self.sampling}

    def line(self) -> str:
        return json.dumps(self.model_dump(mode="json"), ensure_ascii=False) + "\n"


class MissError(ValueError):
    """The record has no answer to a request."""


class RefusalError(RuntimeError):
    """The model, or a filter, refused to answer or gave an empty answer."""


class Record:
    """Answers a request from the record, else asks a provider and records the reply.

    The same request, made again, gets the next of its recorded answers. So an interrupted session
    continues where it stopped and pays for nothing twice.

    ``folder`` has ``transcript.jsonl``, with one JSON line per exchange, and ``images/``; it is
    made at the first writing. ``provider``: ``None`` to replay. ``ValueError``: a line is not an
    exchange, or one is of another provider, model or sampling.
    """

    def __init__(self, folder: Path, provider: Provider | None = None):
        self.folder, self.path, self._provider = folder, folder / TRANSCRIPT, provider
        self.exchanges: list[Exchange] = self._read()
        self.used: list[Exchange] = []
        """All answers that were given so far, in order."""
        models = [e.who for e in self.exchanges if provider and e.who != provider.who]
        if provider and models:
            raise ValueError(
                f"{self.path} is a conversation with {models[0]}; vlm= asks {provider.who}: go on"
                " with the former, or choose another study="
            )

    def _read(self) -> list[Exchange]:
        exchanges = []
        lines = self.path.read_bytes().splitlines() if self.path.exists() else []
        for number, line in enumerate(lines, 1):
            try:
                exchanges.append(Exchange.model_validate_json(line))
            except ValidationError as error:
                raise ValueError(
                    f"{self.path}: line {number} is no exchange: {mistakes(error)}; remove the"
                    " line to ask again"
                ) from error
        return exchanges

    def ask(self, request: Request, conversation: str) -> Exchange:
        """A usable answer; ``conversation`` is a name for the record.

        Raises ``RefusalError``; ``MissError`` without a provider, ``ProviderError`` with one.
        """
        sha256 = request.sha256
        known = [e for e in self.exchanges if e.sha256 == sha256 and e.outcome != "failed"]
        usable = [exchange for exchange in known if exchange.usable]
        position = sum(exchange.sha256 == sha256 for exchange in self.used)
        if position < len(usable):
            exchange = usable[position]
        elif self._provider is not None:
            exchange = self._put(self._provider, request, conversation)
        elif known and not usable:
            # A recorded refusal counts only if nobody can be asked.
            exchange = known[-1]
        else:
            why = "no recorded request is this one: give the settings of the recording"
            if known:
                why = f"this request was answered {len(known)} times, and they are used up"
            raise MissError(
                f"{self.path}: {conversation}: {why}, or ask a model with vlm=gemini, openai or"
                " manual and another study="
            )
        if not exchange.usable:
            model = f"{exchange.provider} ({exchange.answered_by or exchange.model})"
            what = {"refused": "refused to answer", "empty": "gave an empty answer"}
            raise RefusalError(f"{model} {what[exchange.outcome]}: {exchange.detail}")
        self.used.append(exchange)
        return exchange

    def _put(self, provider: Provider, request: Request, conversation: str) -> Exchange:
        """Ask the provider. Its reply, or a failure, is recorded with all new pictures."""
        began, started, failure = time.gmtime(), time.monotonic(), None
        try:
            reply = provider.ask(request)
        except ProviderError as error:
            reply = Reply("failed", "", str(error), None, None, None, (error.status,))
            failure = error
        exchange = Exchange(
            sha256=request.sha256,
            conversation=conversation,
            request=request.canonical(),
            **provider.who,
            **asdict(reply),
            seconds=round(time.monotonic() - started, 3),
            time=time.strftime("%Y-%m-%dT%H:%M:%SZ", began),
        )
        self.folder.mkdir(parents=True, exist_ok=True)
        for part in (part for message in request.messages for part in message.parts):
            if isinstance(part, Png):
                self.save(part)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(exchange.line())
        self.exchanges.append(exchange)
        if failure is not None:
            raise failure
        return exchange

    def save(self, picture: Png) -> str:
        """Keep a picture as ``images/<hash>.png``, once; its hash."""
        path = self.folder / IMAGES / f"{picture.sha256}.png"
        if not path.exists():
            write_whole(path, picture.png)
        return path.stem

    def picture(self, sha256: str) -> Png:
        return Png((self.folder / IMAGES / f"{sha256}.png").read_bytes())

    def retire(self, names: Sequence[str]) -> None:
        """Remove conversations, with ``<name>/…``. The file as it was is kept under a number."""
        below = tuple(f"{name}/" for name in names)
        kept = [e for e in self.exchanges if not f"{e.conversation}/".startswith(below)]
        if len(kept) < len(self.exchanges):
            Run(self.folder).write(TRANSCRIPT, "".join(exchange.line() for exchange in kept))
            self.exchanges = kept
