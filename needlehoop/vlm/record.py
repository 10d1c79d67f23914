"""The record of all that was asked and answered; a new question goes through it to the model."""

from __future__ import annotations

import difflib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from needlehoop.config import strict
from needlehoop.runs.files import write_whole
from needlehoop.runs.machine import commit
from needlehoop.runs.reading import named, read_bytes, read_json
from needlehoop.runs.run import Run
from needlehoop.vlm.config import TRANSCRIPT
from needlehoop.vlm.messages import (
    Canonical,
    Png,
    Provider,
    ProviderError,
    Reply,
    Request,
    mistakes,
)

IMAGES = "images"

EDITION = "prompts.json"
"""The note beside a transcript that says which prompts were asked there."""

_SHOWN = 8
"""Lines of a difference that are shown, at most."""


@dataclass(frozen=True)
class Exchange:
    """One request and its reply; ``outcome`` to ``attempts`` are as in ``Reply``.

    ``seconds`` is the time of all tries, ``time`` the start of the first (UTC).
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True)

    sha256: str
    """The hash of the canonical request."""
    conversation: str
    """``question``, ``rank``, ``rank/2``, ``reward/text`` or ``reward/<cameras>/image``."""
    request: Canonical
    provider: str
    model: str
    """The model asked for."""
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
        """Who was asked and how, as in ``LiveConfig.who``."""
        return {"provider": self.provider, "model": self.model, "sampling": self.sampling}


class MissError(ValueError):
    """The record has no answer to a request."""


class RefusalError(RuntimeError):
    """The model, or a filter, refused to answer or gave an empty answer."""


class Record:
    """Answers a request from the record, else asks a provider and records the reply.

    The same request, made again, gets the next of its recorded answers. So an interrupted session
    continues where it stopped and pays for nothing twice.

    Args:
        folder: of ``transcript.jsonl``, with one JSON line per exchange, and ``images/``. It is
            made at the first writing.
        provider: whom to ask if the record has no answer; ``None`` to replay.
        prompts: the hash of the prompts, to be noted beside the record; ``None`` for no note.

    Raises:
        ValueError: a line is not an exchange, or one is of another provider, model or sampling.
    """

    def __init__(self, folder: Path, provider: Provider | None = None, prompts: str | None = None):
        self.folder, self.path = folder, folder / TRANSCRIPT
        self._provider, self._prompts = provider, prompts
        self.torn: str | None = None
        """What to say of a last line that is cut off and left out; ``None`` if there is none."""
        self.exchanges: list[Exchange] = list(self._read())
        self.used: list[Exchange] = []
        """All answers that were given so far, in order."""
        others = [e.who for e in self.exchanges if provider and e.who != provider.who]
        if provider and others:
            raise ValueError(
                f"{self.path} is a conversation with {_named(others[0])}; vlm= asks"
                f" {_named(provider.who)}: go on with the former, or choose another study="
            )

    def ask(self, request: Request, conversation: str) -> Exchange:
        """A usable answer; ``conversation`` is a name for the record.

        Raises ``RefusalError``; ``MissError`` without a provider, ``ProviderError`` with one.
        """
        exchange = self._recall(request) or self._put(request, conversation)
        if not exchange.usable:
            who = f"{exchange.provider} ({exchange.answered_by or exchange.model})"
            refused = exchange.outcome == "refused"
            what = "refused to answer" if refused else "gave an empty answer"
            raise RefusalError(f"{who} {what}: {exchange.detail}")
        self.used.append(exchange)
        return exchange

    def close(self) -> None:
        """Close the provider."""
        if self._provider is not None:
            self._provider.close()

    def save(self, picture: Png) -> str:
        """Keep a picture as ``images/<hash>.png``, once; its hash."""
        path = self.folder / IMAGES / f"{picture.sha256}.png"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, picture.png)
        return path.stem

    def picture(self, sha256: str) -> Png:
        """A saved picture; ``ValueError`` if it is not there, or has another hash."""
        path = self.folder / IMAGES / f"{sha256}.png"
        if not path.is_file():
            raise ValueError(f"{path}: missing; it belongs to the record")
        picture = Png(_bytes(path))
        if picture.sha256 != sha256:
            raise ValueError(f"{path}: its content is not what its name says")
        return picture

    def retire(self, names: Sequence[str]) -> None:
        """Remove conversations, with ``<name>/…``. The file as it was is kept under a number."""
        below = tuple(f"{name}/" for name in names)
        kept = [e for e in self.exchanges if not f"{e.conversation}/".startswith(below)]
        if len(kept) < len(self.exchanges):
            Run(self.folder).write(TRANSCRIPT, "".join(map(_line, kept)))
            self.exchanges, self.torn = kept, None

    def edition(self) -> Mapping[str, str | None]:
        """The ``sha256`` and ``commit`` (``None`` outside git) of the prompts last asked here.

        Empty where there is no note; ``ValueError`` where it is damaged.
        """
        path = self.folder / EDITION
        try:
            return strict.structure(
                read_json(path) if path.is_file() else {}, Mapping[str, str | None]
            )
        except ValueError as error:
            raise ValueError(f"{path}: not the note of an edition: {error}") from error

    def other_edition(self) -> str | None:
        """What to say of a record that was made with other prompts, if it was."""
        made_with = self.edition()
        if self._prompts is None or made_with.get("sha256") in (None, self._prompts):
            return None
        known = made_with.get("commit")
        which = f"commit {known}" if known else f"sha256 {made_with['sha256']}"
        return (
            f"it was recorded with the prompts of {which}, and these are others: replay it"
            " there, or ask anew into another study="
        )

    def _recall(self, request: Request) -> Exchange | None:
        """The next recorded answer. A recorded refusal counts only if nobody can be asked."""
        known = [e for e in self._answered() if e.sha256 == request.sha256]
        usable = [exchange for exchange in known if exchange.usable]
        position = sum(exchange.sha256 == request.sha256 for exchange in self.used)
        if position < len(usable):
            return usable[position]
        return known[-1] if self._provider is None and known and not usable else None

    def _answered(self) -> list[Exchange]:
        return [e for e in self.exchanges if e.outcome != "failed"]

    def _put(self, request: Request, conversation: str) -> Exchange:
        """Ask the provider. Its reply, or a failure, is recorded with all new pictures."""
        if self._provider is None:
            raise MissError(f"{self.path}: {self._miss(request)}")
        began, started, failure = time.gmtime(), time.monotonic(), None
        try:
            reply = self._provider.ask(request)
        except ProviderError as error:
            reply = Reply("failed", "", str(error), None, None, None, error.attempts)
            failure = error
        exchange = Exchange(
            request.sha256,
            conversation,
            request.canonical(),
            **self._provider.who,
            **asdict(reply),
            seconds=round(time.monotonic() - started, 3),
            time=time.strftime("%Y-%m-%dT%H:%M:%SZ", began),
        )
        for message in request.messages:
            for part in message.parts:
                if isinstance(part, Png):
                    self.save(part)
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.torn is not None:
            os.truncate(self.path, _bytes(self.path).rfind(b"\n") + 1)
            self.torn = None
        with self.path.open("a", encoding="utf-8") as file:
            file.write(_line(exchange))
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

    def _read(self) -> Iterator[Exchange]:
        if not self.path.exists():
            return
        # Split as bytes: the file may be cut off inside a character.
        *lines, rest = _bytes(self.path).split(b"\n")
        for number, line in enumerate(lines, 1):
            try:
                exchange = _EXCHANGE.validate_json(line)
            except ValidationError as error:
                said = "; ".join(mistakes(error))
                raise ValueError(f"{self.path}: line {number} is no exchange: {said}") from error
            yield exchange
        if rest:
            self.torn = f"{self.path}: line {len(lines) + 1} is cut off and left out"

    def _miss(self, request: Request) -> str:
        """Says what is not recorded, and how the nearest recorded request differs."""
        answered, wanted = self._answered(), _lines(request.canonical())
        if not answered:
            return "nothing is recorded; ask a model with vlm=gemini, openai or manual"
        end = _texts(request.canonical())[-1]
        times = sum(exchange.sha256 == request.sha256 for exchange in answered)
        if times:
            return (
                f"this request was answered {times} times, and they are used up; it ends: {end!r}"
            )
        if other := self.other_edition():
            return other
        nearest = max(
            answered,
            key=lambda e: difflib.SequenceMatcher(None, _lines(e.request), wanted).ratio(),
        )
        lines = difflib.unified_diff(_lines(nearest.request), wanted, n=0, lineterm="")
        changes = [line for line in lines if not line.startswith(("---", "+++", "@@"))]
        more = f"\n  … {len(changes) - _SHOWN} lines more" if len(changes) > _SHOWN else ""
        return (
            f"no recorded request is this one, which ends: {end!r}. The nearest (line"
            f" {self.exchanges.index(nearest) + 1}, {nearest.conversation}, {nearest.time}) differs"
            " in (- recorded, + asked):\n  " + "\n  ".join(changes[:_SHOWN]) + more
        )


_EXCHANGE = TypeAdapter(Exchange)


def _line(exchange: Exchange) -> str:
    return json.dumps(asdict(exchange), ensure_ascii=False) + "\n"


def _bytes(path: Path) -> bytes:
    with named(path):
        return read_bytes(path)


def _named(who: Mapping[str, Any]) -> str:
    return f"{who['provider']} {who['model']} {who['sampling']}"


def _lines(request: Canonical) -> list[str]:
    """All of a request, line by line: its texts, its pictures, the form of the answer."""
    parts = [part for message in request["messages"] for part in message["parts"]]
    images = [f"picture {part['image']}" for part in parts if "image" in part]
    form = json.dumps(request["schema"], indent=1, sort_keys=True)
    return [*_texts(request), *images, *form.splitlines()]


def _texts(request: Canonical) -> list[str]:
    parts = [part for message in request["messages"] for part in message["parts"]]
    lines = (line for part in parts for line in part.get("text", "").splitlines())
    return [line for line in lines if line.strip()]
