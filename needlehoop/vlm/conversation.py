"""A conversation: questions one after the other, each with the form of its answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from needlehoop.vlm.messages import Message, Part, Request, mistakes
from needlehoop.vlm.prompts import fill
from needlehoop.vlm.record import Exchange, Record

F = TypeVar("F", bound=BaseModel)


class Verdict(NamedTuple):
    """Why an answer can't be used, as the model is told; ``None``: it can."""

    reason: str | None
    card: Mapping[str, Any] = {}
    """Figures of what was judged, for the record."""


@dataclass(frozen=True)
class Attempt:
    """One answer to a question, as its form or ``None`` for a wrong one, and what was found."""

    exchange: Exchange
    answer: BaseModel | None
    verdict: Verdict


class NoAnswerError(RuntimeError):
    """A question has no usable answer within its attempts."""


class Conversation:
    """All that a model was asked and answered. Every request carries all of it.

    Args:
        record: who answers.
        name: for the record.
        attempts: answers to one question, at most.
    """

    def __init__(self, record: Record, name: str, attempts: int):
        self._record, self._attempts = record, attempts
        self.name = name
        """The name of the next requests. It changes when another command goes on from here."""
        self._messages: tuple[Message, ...] = ()
        self.attempts: list[Attempt] = []
        """All answers so far."""

    def ask(
        self,
        parts: Sequence[Part],
        form: type[F],
        judge: Callable[[F], Verdict] = lambda _: Verdict(None),
    ) -> F:
        """Ask a question until its answer can be used.

        Args:
            parts: text and pictures.
            form: the answer's form.
            judge: of an answer of the right form.

        Raises:
            NoAnswerError: the attempts are used up.
            RefusalError: the model would not answer.
        """
        self._say("user", *parts)
        schema = schema_of(form)
        reason = None
        for _ in range(self._attempts):
            exchange = self._record.ask(Request(self._messages, schema), self.name)
            self._say("assistant", exchange.answer)
            answer, reason = _read(exchange, form)
            verdict = Verdict(reason) if answer is None else judge(answer)
            self.attempts.append(Attempt(exchange, answer, verdict))
            reason = verdict.reason
            if answer is not None and reason is None:
                return answer
            self._say("user", fill("again", reason=reason))
        raise NoAnswerError(
            f"{self.name}: no usable answer in {self._attempts} attempts; the last: {reason}"
            " (all are recorded; more attempts= go on from there)"
        )

    def _say(self, role: str, *parts: Part) -> None:
        self._messages = (*self._messages, Message(role, parts))


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
