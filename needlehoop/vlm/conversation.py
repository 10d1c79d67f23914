"""A conversation: questions one after the other, each with the form of its answer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, create_model

from needlehoop.vlm.description import fill
from needlehoop.vlm.messages import Message, Part, Request, mistakes
from needlehoop.vlm.record import Exchange, Record

_SENT_BACK = fill("again", reason="\n").partition("\n")[0]
"""How a message begins that sends an answer back."""

F = TypeVar("F", bound=BaseModel)


class Verdict(NamedTuple):
    """``reason``: why an answer is refused, or ``None`` if it is accepted. ``report``: its
    figures."""

    reason: str | None
    report: Mapping[str, Any] = {}


class NoAnswerError(RuntimeError):
    """A question has no usable answer within its attempts."""


class Conversation:
    """All that a model was asked and answered. Every request carries all of it.

    ``attempts``: answers to one question, at most; ``name``: of the next requests, for the record.
    """

    def __init__(self, record: Record, name: str, attempts: int):
        self._record, self._attempts, self.name = record, attempts, name
        self._messages: tuple[Message, ...] = ()
        self.attempts: list[tuple[Exchange, BaseModel | None, Verdict]] = []
        """All answers so far: exchange, parsed answer (``None``: not of the form), verdict."""

    def ask(
        self,
        parts: Sequence[Part],
        form: type[F],
        judge: Callable[[F], Verdict] = lambda _: Verdict(None),
    ) -> F:
        """Ask a question until its answer has the form, and the judge has nothing against it.

        ``NoAnswerError``: the attempts are used up. ``RefusalError``: the model would not answer.
        """
        self._say("user", *parts)
        schema, reason = form.model_json_schema(), None
        for _ in range(self._attempts):
            exchange = self._record.ask(Request(self._messages, schema), self.name)
            self._say("assistant", exchange.answer)
            answer = None
            try:
                if exchange.outcome == "truncated":
                    verdict = Verdict("it was cut off at the limit of length; answer more briefly")
                else:
                    answer = form.model_validate_json(exchange.answer)
                    verdict = judge(answer)
            except ValidationError as error:
                wrong = mistakes(error, "answer", 5)
                verdict = Verdict(f"it is not of the form that was asked for: {wrong}")
            self.attempts.append((exchange, answer, verdict))
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


def totals_of(exchanges: Iterable[Exchange]) -> dict[str, dict[str, int]]:
    """Prompts and tokens by conversation, then of all of them as ``all``.

    A request without a reply is not a prompt. An answer is invalid if it was cut off, refused,
    empty or sent back. The last attempt at a question is never sent back, so it counts as valid.
    """
    prompts = [e for e in exchanges if e.outcome != "failed"]
    sent_back = [
        before
        for *before, last in (e.request["messages"] for e in prompts)
        if last["parts"][0].get("text", "").startswith(_SENT_BACK)
    ]

    def is_invalid(exchange: Exchange) -> bool:
        answer = {"role": "assistant", "parts": [{"text": exchange.answer}]}
        turns = [*exchange.request["messages"], answer]
        return exchange.outcome != "answered" or turns in sent_back

    names = dict.fromkeys(e.conversation for e in prompts)
    chosen = {name: [e for e in prompts if e.conversation == name] for name in names}
    return {
        name: {
            "prompts": len(group),
            "tokens_in": sum(e.tokens_in or 0 for e in group),
            "tokens_out": sum(e.tokens_out or 0 for e in group),
            "prompts_without_token_count": sum(None in (e.tokens_in, e.tokens_out) for e in group),
            "invalid_answers": sum(map(is_invalid, group)),
        }
        for name, group in {**chosen, "all": prompts}.items()
    }


def in_words(totals: Mapping[str, int]) -> str:
    prompts, into, out, unknown, invalid = totals.values()
    unknown = f"; {unknown} prompts not counted" if unknown else ""
    return (
        f"{prompts} prompts, {into + out} tokens ({into} in, {out} out{unknown}),"
        f" {invalid} invalid answers"
    )


def _not_empty(value: str) -> str:
    if not value.strip():
        raise ValueError("it is empty")
    return value


# Not pydantic's min_length: some servers refuse schemas that have one.
Text = Annotated[str, AfterValidator(_not_empty)]


def _without_notes(schema: dict[str, Any]) -> None:
    """Removes titles and docstrings from a JSON schema: they would change a request's hash."""
    for part in (schema, *schema.get("properties", {}).values()):
        part.pop("title", None)
    schema.pop("description", None)


class Form(BaseModel):
    """An answer with all fields and no others. Its JSON schema goes to the model."""

    model_config = ConfigDict(extra="forbid", json_schema_extra=_without_notes)


class Subtask(Form):
    name: Text
    description: Text


class Subtasks(Form):
    first: Subtask
    second: Subtask


class Guess(Form):
    """What the task is taken to be."""

    task: Text


class ProgramAnswer(Form):
    """A reward program, and why it is as it is."""

    explanation: Text
    program: Text


def _one_of(valid: Sequence[str]) -> Any:
    """The type of a string that is one of ``valid``.

    Not a ``Literal``: the message of its error, which goes back to the model, is another.
    """

    def check(value: str) -> str:
        if value not in valid:
            raise ValueError(f"{value!r} is not one of {', '.join(valid)}")
        return value

    return Annotated[str, AfterValidator(check), Field(json_schema_extra={"enum": list(valid)})]


def choice(views: Sequence[str], renderings: Sequence[str]) -> type[Form]:
    """A view and a rendering, with a reason for each."""
    return create_model(
        "Choice",
        __base__=Form,
        view=(_one_of(views), ...),
        view_reason=(Text, ...),
        rendering=(_one_of(renderings), ...),
        rendering_reason=(Text, ...),
    )


def choices(views: Sequence[str], renderings: Sequence[str]) -> type[Form]:
    """A choice for each of the two subtasks."""
    form = choice(views, renderings)
    return create_model("Choices", __base__=Form, first=(form, ...), second=(form, ...))


def ranking(names: Sequence[str]) -> type[Form]:
    """All of ``names``, each once, the best first, each with a reason; and how sure that is.

    ``sure`` has a number for each two neighbours in the order, 0.5 to 1.
    """
    place: Any = create_model(
        "Place", __base__=Form, name=(_one_of(names), ...), reason=(Text, ...)
    )

    def check(places: list[Any]) -> list[Any]:
        order = [entry.name for entry in places]
        if sorted(order) != sorted(names):
            missing = [name for name in names if name not in order]
            twice = sorted({name for name in order if order.count(name) > 1})
            raise ValueError(
                "the ranking must name each entry of the list once;"
                f" missing: {', '.join(missing) or 'none'};"
                f" named twice: {', '.join(twice) or 'none'}"
            )
        return places

    def check_sure(sure: list[float]) -> list[float]:
        if len(sure) != len(names) - 1 or not all(0.5 <= value <= 1 for value in sure):
            raise ValueError(f"it must be {len(names) - 1} numbers from 0.5 to 1; got {sure}")
        return sure

    kind: Any = Annotated[list[place], AfterValidator(check)]
    sure: Any = Annotated[list[float], AfterValidator(check_sure)]
    return create_model("Ranking", __base__=Form, places=(kind, ...), sure=(sure, ...))
