"""A conversation: questions one after the other, each with the form of its answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from needlehoop.vlm.messages import Message, Part, Request, mistakes
from needlehoop.vlm.prompts import fill
from needlehoop.vlm.recorder import Recorder
from needlehoop.vlm.tables import totals
from needlehoop.vlm.transcript import Exchange

F = TypeVar("F", bound=BaseModel)


@dataclass(frozen=True)
class Attempt:
    """One answer to a question; ``reason`` says why it was sent back, if it was."""

    exchange: Exchange
    reason: str | None


class NoAnswerError(RuntimeError):
    """A question has no usable answer within its attempts."""


class Conversation:
    """All that a model was asked and answered. Every request carries all of it.

    Args:
        recorder: who answers.
        name: for the record.
        attempts: answers to one question, at most.
    """

    def __init__(self, recorder: Recorder, name: str, attempts: int):
        self._recorder, self._attempts = recorder, attempts
        self.name = name
        """The name of the next requests. It changes when another command goes on from here."""
        self._messages: tuple[Message, ...] = ()
        self.attempts: list[Attempt] = []
        """All answers so far."""

    def ask(
        self,
        parts: Sequence[Part],
        form: type[F],
        judge: Callable[[F], str | None] | None = None,
    ) -> F:
        """Ask a question until its answer can be used.

        Args:
            parts: text and pictures.
            form: the answer's form.
            judge: gives the reason why an answer of the right form can't be used, or ``None``.

        Raises:
            NoAnswerError: the attempts are used up.
            RefusalError: the model would not answer.
        """
        self._say("user", *parts)
        schema = schema_of(form)
        reason = None
        for _ in range(self._attempts):
            exchange = self._recorder.ask(Request(self._messages, schema), self.name)
            self._say("assistant", exchange.answer)
            answer, reason = _read(exchange, form)
            if answer is not None and judge is not None:
                reason = judge(answer)
            self.attempts.append(Attempt(exchange, reason))
            if answer is not None and reason is None:
                return answer
            self._say("user", fill("again", reason=reason))
        raise NoAnswerError(
            f"{self.name}: no usable answer in {self._attempts} attempts; the last: {reason}"
            " (all are recorded; more attempts= go on from there)"
        )

    def _say(self, role: str, *parts: Part) -> None:
        self._messages = (*self._messages, Message(role, parts))


def totals_of(conversations: Sequence[Conversation]) -> dict[str, int]:
    """Prompts, tokens and unusable answers."""
    attempts = [attempt for one in conversations for attempt in one.attempts]
    invalid = sum(attempt.reason is not None for attempt in attempts)
    return totals([attempt.exchange for attempt in attempts], invalid)


def models(conversations: Sequence[Conversation]) -> list[str]:
    """The models that answered, each once, as ``provider model``."""
    exchanges = (attempt.exchange for one in conversations for attempt in one.attempts)
    return list(dict.fromkeys(f"{e.provider} {e.answered_by}" for e in exchanges))


def schema_of(form: type[BaseModel]) -> dict[str, Any]:
    """A form's JSON schema without titles and descriptions.

    Those come from names and docstrings. With them a reworded docstring would change the hash of
    a request, and its recorded answer would not be found.
    """
    return _without_notes(form.model_json_schema())


def _without_notes(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: _without_notes(inner)
            for key, inner in value.items()
            # A field may have either name; its value is a dict.
            if not (key in ("title", "description") and isinstance(inner, str))
        }
    return [_without_notes(inner) for inner in value] if isinstance(value, list) else value


def _read(exchange: Exchange, form: type[F]) -> tuple[F | None, str | None]:
    """The answer, or the reason why it can't be used."""
    if exchange.outcome == "truncated":
        return None, "it was cut off at the limit of length; answer more briefly"
    try:
        return form.model_validate_json(exchange.answer), None
    except ValidationError as error:
        reasons = "; ".join(mistakes(error, "answer", 5))
        return None, f"it is not of the form that was asked for: {reasons}"
