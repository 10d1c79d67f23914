"""The record of all that was asked and answered; a new question goes through it to the model."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from needlehoop.runs.files import write_whole
from needlehoop.runs.machine import commit
from needlehoop.runs.run import Run
from needlehoop.vlm.config import TRANSCRIPT
from needlehoop.vlm.messages import Png, Provider, ProviderError, Reply, Request, mistakes

IMAGES = "images"

EDITION = "prompts.json"
"""The note beside a transcript that says which prompts were asked there."""


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
        """Its line of a transcript."""
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
    made at the first writing. ``provider``: ``None`` to replay. ``prompts``: their hash, to be
    noted beside the record. ``ValueError``: a line is not an exchange, or one is of another
    provider, model or sampling.
    """

    def __init__(self, folder: Path, provider: Provider | None = None, prompts: str | None = None):
        self.folder, self.path = folder, folder / TRANSCRIPT
        self._provider, self._prompts = provider, prompts
        self.exchanges: list[Exchange] = self._read()
        self.used: list[Exchange] = []
        """All answers that were given so far, in order."""
        others = [e.who for e in self.exchanges if provider and e.who != provider.who]
        if provider and others:
            raise ValueError(
                f"{self.path} is a conversation with {others[0]}; vlm= asks {provider.who}: go on"
                " with the former, or choose another study="
            )

    def ask(self, request: Request, conversation: str) -> Exchange:
        """A usable answer; ``conversation`` is a name for the record.

        Raises ``RefusalError``; ``MissError`` without a provider, ``ProviderError`` with one.
        """
        exchange = self._recall(request) or self._put(request, conversation)
        if not exchange.usable:
            who = f"{exchange.provider} ({exchange.answered_by or exchange.model})"
            what = {"refused": "refused to answer", "empty": "gave an empty answer"}
            raise RefusalError(f"{who} {what[exchange.outcome]}: {exchange.detail}")
        self.used.append(exchange)
        return exchange

    def save(self, picture: Png) -> str:
        """Keep a picture as ``images/<hash>.png``, once; its hash."""
        path = self.folder / IMAGES / f"{picture.sha256}.png"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, picture.png)
        return path.stem

    def picture(self, sha256: str) -> Png:
        """A saved picture; ``ValueError`` if it has another hash."""
        path = self.folder / IMAGES / f"{sha256}.png"
        picture = Png(path.read_bytes())
        if picture.sha256 != sha256:
            raise ValueError(f"{path}: its content is not what its name says")
        return picture

    def retire(self, names: Sequence[str]) -> None:
        """Remove conversations, with ``<name>/…``. The file as it was is kept under a number."""
        below = tuple(f"{name}/" for name in names)
        kept = [e for e in self.exchanges if not f"{e.conversation}/".startswith(below)]
        if len(kept) < len(self.exchanges):
            Run(self.folder).write(TRANSCRIPT, "".join(one.line() for one in kept))
            self.exchanges = kept

    def edition(self) -> dict[str, str | None]:
        """``sha256`` and ``commit`` (``None`` outside git) of the prompts last asked; or empty."""
        path = self.folder / EDITION
        return json.loads(path.read_text()) if path.is_file() else {}

    def _recall(self, request: Request) -> Exchange | None:
        """The next recorded answer. A recorded refusal counts only if nobody can be asked."""
        known = self._answers(request)
        usable = [exchange for exchange in known if exchange.usable]
        position = sum(exchange.sha256 == request.sha256 for exchange in self.used)
        if position < len(usable):
            return usable[position]
        return known[-1] if self._provider is None and known and not usable else None

    def _answers(self, request: Request) -> list[Exchange]:
        sha256 = request.sha256
        return [e for e in self.exchanges if e.sha256 == sha256 and e.outcome != "failed"]

    def _put(self, request: Request, conversation: str) -> Exchange:
        """Ask the provider. Its reply, or a failure, is recorded with all new pictures."""
        if self._provider is None:
            raise MissError(f"{self.path}: {conversation}: {self._miss(request)}")
        began, started, failure = time.gmtime(), time.monotonic(), None
        try:
            reply = self._provider.ask(request)
        except ProviderError as error:
            reply = Reply("failed", "", str(error), None, None, None, (error.status,))
            failure = error
        exchange = Exchange(
            sha256=request.sha256,
            conversation=conversation,
            request=request.canonical(),
            **self._provider.who,
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
            file.flush()
            os.fsync(file.fileno())
        self.exchanges.append(exchange)
        if self._prompts is not None and self.edition().get("sha256") != self._prompts:
            # The note of an earlier edition is kept under a number.
            text = json.dumps({"commit": commit(), "sha256": self._prompts}, indent=2)
            Run(self.folder).write(EDITION, text + "\n")
        if failure is not None:
            raise failure
        return exchange

    def _read(self) -> list[Exchange]:
        found = []
        lines = self.path.read_bytes().splitlines() if self.path.exists() else []
        for number, line in enumerate(lines, 1):
            try:
                found.append(Exchange.model_validate_json(line))
            except ValidationError as error:
                raise ValueError(
                    f"{self.path}: line {number} is no exchange: {mistakes(error)}; remove the"
                    " line to ask again"
                ) from error
        return found

    def _miss(self, request: Request) -> str:
        if not self.exchanges:
            return "nothing is recorded; ask a model with vlm=gemini, openai or manual"
        if times := len(self._answers(request)):
            return f"this request was answered {times} times, and they are used up"
        return (
            "no recorded request is this one. Give the settings of the recording (and the prompts"
            f" of its commit, {self.edition().get('commit')}), or ask a model with vlm=gemini,"
            " openai or manual and another study="
        )
