"""Answers from the record if it has them, else from the model if there is one."""

from __future__ import annotations

import difflib
import time
from dataclasses import asdict
from typing import Any

from needlehoop.vlm import prompts
from needlehoop.vlm.config import AskingConfig
from needlehoop.vlm.messages import Canonical, Request
from needlehoop.vlm.providers import Provider, ProviderError, Reply
from needlehoop.vlm.transcript import Exchange, Transcript

_SHOWN = 8
"""Lines of a difference that are shown, at most."""


class MissError(ValueError):
    """The record has no answer to a request."""


class RefusalError(RuntimeError):
    """The model, or a filter, refused to answer or gave an empty answer."""


class Recorder:
    """Looks a request up in the record, else asks a provider and records the reply.

    The same request, made again, gets the next of its recorded answers. So an interrupted
    session continues where it stopped and pays for nothing twice. A session that is recorded
    completely needs no provider.

    Args:
        transcript: the record.
        provider: whom to ask if the record has no answer; ``None`` to replay.
        config: of the provider.
        asked: the hash of the prompts, to be noted beside the record; ``None`` for no note.

    Raises:
        ValueError: the record is of another provider, model or sampling than ``config``.
    """

    def __init__(
        self,
        transcript: Transcript,
        provider: Provider | None = None,
        config: AskingConfig | None = None,
        asked: str | None = None,
    ):
        self.transcript, self._asked = transcript, asked
        self._provider, self._config = provider, config
        self.used: list[Exchange] = []
        """All answers that were given so far, in order."""
        if config is not None:
            for other in (e.asked for e in transcript.exchanges if e.asked != config.asked):
                raise ValueError(
                    f"{transcript.path} is a conversation with {_who(other)}; vlm= asks"
                    f" {_who(config.asked)}: go on with the former, or choose another study="
                )

    def ask(self, request: Request, conversation: str) -> Exchange:
        """A usable answer; ``conversation`` is a name for the record.

        Raises:
            RefusalError: the model would not answer, or its answer is empty.
            MissError: nothing is recorded, and there is no provider.
            ProviderError: the provider could not be made to reply.
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
        """Close the provider's connections."""
        if self._provider is not None:
            self._provider.close()

    def _recall(self, request: Request) -> Exchange | None:
        """The next recorded answer. A recorded refusal counts only if nobody can be asked."""
        known = [e for e in self._answered() if e.sha256 == request.sha256]
        usable = [exchange for exchange in known if exchange.usable]
        position = sum(exchange.sha256 == request.sha256 for exchange in self.used)
        if position < len(usable):
            return usable[position]
        return known[-1] if self._provider is None and known and not usable else None

    def _answered(self) -> list[Exchange]:
        return [e for e in self.transcript.exchanges if e.outcome != "failed"]

    def _put(self, request: Request, conversation: str) -> Exchange:
        provider, config = self._provider, self._config
        if provider is None or config is None:
            raise MissError(f"{self.transcript.path}: {self._miss(request)}")
        began, started, failure = time.gmtime(), time.monotonic(), None
        try:
            reply = provider.ask(request)
        except ProviderError as error:
            reply = Reply("failed", "", str(error), None, None, None, error.attempts)
            failure = error
        exchange = Exchange(
            sha256=request.sha256,
            conversation=conversation,
            request=request.canonical(),
            **config.asked,
            **asdict(reply),
            seconds=round(time.monotonic() - started, 3),
            time=time.strftime("%Y-%m-%dT%H:%M:%SZ", began),
        )
        self.transcript.add(exchange, request)
        if self._asked is not None:
            prompts.sign(self.transcript.folder, self._asked)
        if failure is not None:
            raise failure
        return exchange

    def _miss(self, request: Request) -> str:
        """Says what is not recorded, and how the nearest recorded request differs."""
        answered, wanted = self._answered(), request.canonical()
        if not answered:
            return "nothing is recorded; ask a model with vlm=gemini, openai or manual"
        lines = _lines(wanted)
        times = sum(exchange.sha256 == request.sha256 for exchange in answered)
        if times:
            return (
                f"this request was answered {times} times, and they are used up; it ends:"
                f" {lines[-1]!r}"
            )
        other = self._asked and prompts.other_edition(self.transcript.folder, self._asked)
        if other:
            return other
        nearest = max(
            answered,
            key=lambda e: difflib.SequenceMatcher(None, _lines(e.request), lines).ratio(),
        )
        return (
            f"no recorded request is this one, which ends: {lines[-1]!r}. The nearest (line"
            f" {self.transcript.exchanges.index(nearest) + 1}, {nearest.conversation},"
            f" {nearest.time}) differs in: {_difference(nearest.request, wanted)}"
        )


def _who(asked: dict[str, Any]) -> str:
    return f"{asked['provider']} {asked['model']} {asked['sampling']}"


def _difference(recorded: Canonical, wanted: Canonical) -> str:
    """The difference of two requests, in a few lines."""
    said, lines = [], difflib.unified_diff(_lines(recorded), _lines(wanted), n=0, lineterm="")
    changes = [line for line in lines if not line.startswith(("---", "+++", "@@"))]
    if changes:
        shown = "\n  ".join(["the text (- recorded, + asked):", *changes[:_SHOWN]])
        more = len(changes) - _SHOWN
        said.append(f"{shown} (and {more} lines more)" if more > 0 else shown)
    if _parts(recorded, "image") != _parts(wanted, "image"):
        said.append("the images")
    if recorded["schema"] != wanted["schema"]:
        said.append("the form of the answer (schema)")
    return "; ".join(said)


def _lines(request: Canonical) -> list[str]:
    return [line for text in _parts(request, "text") for line in text.splitlines() if line.strip()]


def _parts(request: Canonical, kind: str) -> list[str]:
    parts = (part for message in request["messages"] for part in message["parts"])
    return [part[kind] for part in parts if kind in part]
