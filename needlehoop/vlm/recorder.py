"""Answers from the record if it has them, else from the model if there is one."""

from __future__ import annotations

import difflib
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from needlehoop.vlm import prompts
from needlehoop.vlm.messages import Request
from needlehoop.vlm.providers.contract import AskingConfig, Provider, ProviderError, Reply
from needlehoop.vlm.transcript import Exchange, Transcript


def persist(
    ask: Callable[[], Reply], config: AskingConfig, sleep: Callable[[float], None]
) -> tuple[Reply, tuple[int | str, ...]]:
    """Try until there is a reply, a lasting failure, or no try left.

    Nothing else decides on retries: those of the SDKs are off.

    Args:
        ask: one try.
        config: ``tries``, ``first_wait`` and ``longest_wait``.
        sleep: waits a number of seconds.

    Returns:
        The reply, and the status of each try.

    Raises:
        ProviderError: the last failure, with the statuses of all tries.
    """
    attempts: tuple[int | str, ...] = ()
    while True:
        try:
            return ask(), (*attempts, config.arrived)
        except ProviderError as error:
            attempts = (*attempts, error.status)
            if error.passing and len(attempts) < config.tries:
                sleep(min(config.longest_wait, config.first_wait * 2 ** (len(attempts) - 1)))
                continue
            tried = f" (tried {len(attempts)} times)" if len(attempts) > 1 else ""
            raise ProviderError(f"{error}{tried}", error.status, attempts) from None


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
        sleep: waits a number of seconds between tries.
        asked: the hash of the prompts, to be noted beside the record; ``None`` for no note.

    Raises:
        ValueError: the record is of another provider, model or sampling than ``config``.
    """

    def __init__(
        self,
        transcript: Transcript,
        provider: Provider | None = None,
        config: AskingConfig | None = None,
        sleep: Callable[[float], None] = time.sleep,
        asked: str | None = None,
    ):
        self.transcript, self._asked = transcript, asked
        self._provider, self._config, self._sleep = provider, config, sleep
        self._used: Counter[str] = Counter()
        if config is not None:
            _check_same(transcript, config)

    def ask(self, request: Request, conversation: str) -> Exchange:
        """A usable answer.

        Args:
            request: the conversation so far.
            conversation: its name, for the record.

        Raises:
            RefusalError: the model would not answer, or its answer is empty.
            MissError: nothing is recorded, and there is no provider.
            ProviderError: the provider could not be made to reply.
        """
        exchange = self._recall(request) or self._put(request, conversation)
        if not exchange.usable:
            raise RefusalError(_refusal(exchange))
        return exchange

    def close(self) -> None:
        """Close the provider's connections."""
        if self._provider is not None:
            self._provider.close()

    def _recall(self, request: Request) -> Exchange | None:
        """The next recorded answer. A recorded refusal counts only if nobody can be asked."""
        sha256 = request.sha256
        found = [e for e in self.transcript.exchanges if e.sha256 == sha256 and e.usable]
        position = self._used[sha256]
        if position < len(found):
            self._used[sha256] += 1
            return found[position]
        if self._provider is None:
            refused = [
                e
                for e in self.transcript.exchanges
                if e.sha256 == sha256 and e.outcome in ("refused", "empty")
            ]
            return refused[-1] if refused and not found else None
        return None

    def _put(self, request: Request, conversation: str) -> Exchange:
        provider, config = self._provider, self._config
        if provider is None or config is None:
            raise MissError(_miss(self.transcript, request, self._asked))
        began, started = time.gmtime(), time.monotonic()

        def record(reply: Reply, attempts: tuple[int | str, ...]) -> Exchange:
            exchange = Exchange(
                sha256=request.sha256,
                conversation=conversation,
                request=request.canonical(),
                **config.asked,
                outcome=reply.outcome,
                answer=reply.answer,
                detail=reply.detail,
                answered_by=reply.model or None,
                tokens_in=reply.tokens_in,
                tokens_out=reply.tokens_out,
                attempts=attempts,
                seconds=round(time.monotonic() - started, 3),
                time=time.strftime("%Y-%m-%dT%H:%M:%SZ", began),
            )
            self.transcript.add(exchange, request)
            if self._asked is not None:
                prompts.sign(self.transcript.folder, self._asked)
            return exchange

        try:
            reply, attempts = persist(lambda: provider.ask(request), config, self._sleep)
        except ProviderError as error:
            record(Reply("failed", "", str(error), "", None, None), error.attempts)
            raise
        exchange = record(reply, attempts)
        self._used[exchange.sha256] += exchange.usable
        return exchange


def _check_same(transcript: Transcript, config: AskingConfig) -> None:
    for exchange in transcript.exchanges:
        if exchange.asked != config.asked:
            raise ValueError(
                f"{transcript.path} is a conversation with {_who(exchange.asked)}; vlm= asks"
                f" {_who(config.asked)}: go on with the former, or choose another study="
            )


def _who(asked: dict[str, Any]) -> str:
    return f"{asked['provider']} {asked['model']} {asked['sampling']}"


def _refusal(exchange: Exchange) -> str:
    who = f"{exchange.provider} ({exchange.answered_by or exchange.model})"
    what = "refused to answer" if exchange.outcome == "refused" else "gave an empty answer"
    return f"{who} {what}: {exchange.detail}"


def _miss(transcript: Transcript, request: Request, asked: str | None) -> str:
    """Says what is not recorded, and how the nearest recorded request differs."""
    answered = [exchange for exchange in transcript.exchanges if exchange.outcome != "failed"]
    if not answered:
        return (
            f"{transcript.path}: nothing is recorded; ask a model with vlm=gemini, openai or manual"
        )
    wanted = request.canonical()
    if any(exchange.sha256 == request.sha256 for exchange in answered):
        count = sum(exchange.sha256 == request.sha256 for exchange in answered)
        return (
            f"{transcript.path}: this request was answered {count} times, and they are used up;"
            f" it ends: {_lines(wanted)[-1]!r}"
        )

    other = asked and prompts.other_edition(transcript.folder, asked)
    if other:
        return f"{transcript.path} {other}"

    def likeness(exchange: Exchange) -> float:
        return difflib.SequenceMatcher(None, _lines(exchange.request), _lines(wanted)).ratio()

    nearest = max(answered, key=likeness)
    return (
        f"{transcript.path}: no recorded request is this one, which ends:"
        f" {_lines(wanted)[-1]!r}. The nearest (line"
        f" {transcript.exchanges.index(nearest) + 1}, {nearest.conversation}, {nearest.time})"
        f" differs in: {_difference(nearest.request, wanted)}"
    )


def _difference(recorded: dict[str, Any], wanted: dict[str, Any]) -> str:
    """The difference of two canonical requests, in a few lines."""
    said = []
    lines = difflib.unified_diff(_lines(recorded), _lines(wanted), "recorded", "asked", "", "", 0)
    changes = [line for line in lines if not line.startswith(("---", "+++", "@@"))]
    if changes:
        more = f" (and {len(changes) - 8} lines more)" if len(changes) > 8 else ""
        said.append("the text (- recorded, + asked):\n  " + "\n  ".join(changes[:8]) + more)
    before, after = _images(recorded), _images(wanted)
    if before != after:
        said.append(
            f"the images: {len(before)} recorded, {len(after)} asked,"
            f" {len(set(before) & set(after))} in both"
        )
    if recorded["schema"] != wanted["schema"]:
        said.append("the form of the answer (schema)")
    return "; ".join(said)


def _lines(request: dict[str, Any]) -> list[str]:
    return [
        line
        for message in request["messages"]
        for part in message["parts"]
        for line in part.get("text", "").splitlines()
        if line.strip()
    ]


def _images(request: dict[str, Any]) -> list[str]:
    return [
        part["image"]
        for message in request["messages"]
        for part in message["parts"]
        if "image" in part
    ]
