"""The forms of answers. A form's JSON schema goes to the model; its checks run here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model


def _not_empty(value: str) -> str:
    if not value.strip():
        raise ValueError("it is empty")
    return value


# Not pydantic's min_length: some servers refuse schemas that have one.
Text = Annotated[str, AfterValidator(_not_empty)]


class Form(BaseModel):
    """An answer with all fields and no others."""

    model_config = ConfigDict(extra="forbid")


class Subtask(Form):
    """A part of the task."""

    name: Text
    description: Text


class Subtasks(Form):
    """The task in two parts."""

    first: Subtask
    second: Subtask


class Guess(Form):
    """What the task is taken to be."""

    task: Text


class ProgramAnswer(Form):
    """A reward program, and why it is as it is."""

    explanation: Text
    program: Text


def one_of(valid: Sequence[str]) -> Any:
    """The type of a string that is one of ``valid``."""

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
        view=(one_of(views), ...),
        view_reason=(Text, ...),
        rendering=(one_of(renderings), ...),
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
    place: Any = create_model("Place", __base__=Form, name=(one_of(names), ...), reason=(Text, ...))

    def check(places: list[Any]) -> list[Any]:
        given = [entry.name for entry in places]
        if sorted(given) != sorted(names):
            missing = [name for name in names if name not in given]
            twice = sorted({name for name in given if given.count(name) > 1})
            raise ValueError(
                "the ranking must name each entry of the list once;"
                f" missing: {', '.join(missing) or 'none'};"
                f" named twice: {', '.join(twice) or 'none'}"
            )
        return places

    def check_sure(sure: list[float]) -> list[float]:
        if len(sure) != len(names) - 1 or not all(0.5 <= one <= 1 for one in sure):
            raise ValueError(f"it must be {len(names) - 1} numbers from 0.5 to 1; got {sure}")
        return sure

    kind: Any = Annotated[list[place], AfterValidator(check)]
    sure: Any = Annotated[list[float], AfterValidator(check_sure)]
    return create_model("Ranking", __base__=Form, places=(kind, ...), sure=(sure, ...))
