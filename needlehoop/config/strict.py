"""Plain values as dataclasses, checked by pydantic; an error is one line for each wrong key.

A field's type has its range: ``steps: Annotated[int, Range(1)]``, or the texts that it may be:
``grasp: Annotated[str, OneOf("weld", "friction")]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import SimpleNamespace
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import ErrorDetails

from needlehoop.runs.reading import printable

T = TypeVar("T")

_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)

_WORDS = {
    "greater_than_equal": "must be at least {ge:g}",
    "greater_than": "must be above {gt:g}",
    "less_than_equal": "must be at most {le:g}",
    "int_from_float": "is not a whole number",
    "int_parsing": "is not a whole number",
    "int_type": "is not a whole number",
    "float_parsing": "is not a number",
    "float_type": "is not a number",
    "finite_number": "is not finite",
    "bool_parsing": "is not true or false",
    "bool_type": "is not true or false",
    "string_type": "is not a text",
}
"""pydantic's most usual errors in plainer words."""


def Range(low: float | None = None, high: float | None = None, above: bool = False) -> Any:  # noqa: N802
    """The range of a number, ends included; ``above`` excludes the lower end."""
    return Field(gt=low, le=high) if above else Field(ge=low, le=high)


def OneOf(*valid: str) -> Any:  # noqa: N802
    """The texts that a setting may be."""

    def check(text: str) -> str:
        if text not in valid:
            raise ValueError(f"{shown(text)} is unknown; choose from {', '.join(valid)}")
        return text

    return AfterValidator(check)


def _split(value: Any) -> Any:
    return value.split(",") if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_split)]
"""A list of names, or a text with commas between them."""

Count = Annotated[int, Range(1, 1e9)]
"""A count of at least 1."""

Number = Annotated[int, Range(0, 1e9)]
"""A count that may be 0."""

Seed = Annotated[int, Range(0, 2**63 - 2)]
"""A seed that torch and numpy take, and after which there is a next one."""

Positive = Annotated[float, Range(0.0, 1e9, above=True)]
Amount = Annotated[float, Range(0.0, 1e9)]
"""A number that is not negative."""

Pixels = Annotated[int, Range(1, 4096)]
"""Side of a picture for people, px."""

Real = Annotated[float, Range(-1e9, 1e9)]
Share = Annotated[float, Range(0.0, 1.0)]


def structure(values: Any, kind: Any, path: str = "") -> Any:
    """Plain values as a dataclass, or as another type that fields may have.

    There may be no other keys than the dataclass has. ``path`` says in errors where they stand.

    Raises:
        ValueError: names every key that is wrong, and why.
    """
    try:
        (result,) = _adapter(kind).validate_python((values,))
    except ValidationError as error:
        lines = [_line(one, kind, path) for one in error.errors(include_url=False)]
        raise ValueError("; ".join(dict.fromkeys(lines))) from error
    return result


def as_type(values: Mapping[str, Any], kind: type[T]) -> T:
    """The values that a dataclass names, as one; errors are as in ``structure``."""
    names = getattr(kind, "__dataclass_fields__", {})
    return structure({name: values[name] for name in names}, kind)


def value(values: Mapping[str, Any], key: str, kind: Any) -> Any:
    """One value of a composed config; ``ValueError`` with its key where it is of another kind."""
    return structure(values[key], kind, key)


def read(values: Mapping[str, Any], **kinds: Any) -> SimpleNamespace:
    """Several such values, as attributes; errors as in ``value``."""
    return SimpleNamespace(**{key: value(values, key, kind) for key, kind in kinds.items()})


def shown(value: Any) -> str:
    """A value as one line of at most 60 characters, for errors."""
    text = printable(repr(value))
    return text if len(text) <= 60 else f"{text[:60]}…"


def check_names(key: str, names: Sequence[str], valid: Sequence[str]) -> None:
    """Raises ``ValueError`` for an unknown or repeated name in a setting."""
    for name in names:
        if name not in valid:
            raise ValueError(f"{key}: {name!r} is unknown; choose from {', '.join(valid)}")
    if len(set(names)) < len(names):
        raise ValueError(f"{key}: {', '.join(names)} names one twice")


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    # In a tuple: pydantic hands its config on to dataclasses within another type alone.
    in_tuple: Any = tuple.__class_getitem__(kind)
    return TypeAdapter(in_tuple, config=_CONFIG)


def _line(error: ErrorDetails, kind: Any, path: str) -> str:
    """One of pydantic's errors, with its key and the valid values."""
    inner = [str(part) for part in error["loc"][1:]]
    is_key = error["type"] in ("unexpected_keyword_argument", "missing")
    # A tuple that is too short misses an index.
    is_key &= isinstance(error["loc"][-1], str)
    above = inner[:-1] if is_key else inner
    where = ".".join(filter(None, (path, *above)))
    if is_key:
        names = ", ".join(f.name for f in fields(_type_at(kind, above)))
        key = shown(inner[-1])[1:-1]
        what = f"{key} is missing" if error["type"] == "missing" else f"unknown key {key}"
        text = f"{what}; its keys are {names}"
    elif error["type"] == "value_error":
        text = str(error.get("ctx", {})["error"])
        # What a dataclass says of its own fields may name the key already.
        if not where or text.startswith(where.split(".")[0]):
            return text
    else:
        words = _WORDS.get(error["type"], error["msg"].replace("Input should", "should"))
        text = f"{shown(error['input'])} {words.format(**error.get('ctx', {}))}"
    return f"{where}: {text}" if where else text


def _type_at(kind: Any, keys: Sequence[str]) -> Any:
    """The dataclass that lies below some keys of a type."""
    if get_origin(kind) is Annotated:
        return _type_at(get_args(kind)[0], keys)
    if is_dataclass(kind):
        hints = get_type_hints(kind, include_extras=True)
        return _type_at(hints[keys[0]], keys[1:]) if keys else kind
    inner = [one for one in get_args(kind) if one is not type(None)]
    # A mapping's values, a list's items; a type that may be None adds no key.
    is_keyed = get_origin(kind) in (Mapping, dict, tuple)
    return _type_at(inner[0 if get_origin(kind) is tuple else -1], keys[1:] if is_keyed else keys)
