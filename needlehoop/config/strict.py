"""The one converter: from plain values, as a config has them, to what a dataclass's fields say.

It guesses nothing: no text for a number, no ``off`` for false, no NaN, no ``None`` for a name.
A field's type has its range: ``steps: Annotated[int, Range(1)]``, or the texts that it may be:
``keep: Annotated[str, OneOf("last", "best")]``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from types import SimpleNamespace
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from needlehoop.runs.reading import printable

T = TypeVar("T")

_LONGEST = 1_000
"""Characters of a text field, at most."""

_LONGEST_PROGRAM = 100_000
"""Characters of a text in a free mapping, such as a reward's program, at most."""

_SHOWN = 60
"""Characters of a value in an error, at most."""


@dataclass(frozen=True)
class Range:
    """The range of a number, ends included; ``above`` excludes the lower end."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False

    def check(self, value: float) -> None:
        """Raises ``ValueError`` for a number out of the range."""
        if value > self.high:
            raise ValueError(f"{shown(value)} must be at most {self.high:g}")
        if value > self.low or (value == self.low and not self.above):
            return
        least = f"must be {'above' if self.above else 'at least'} {self.low:g}"
        if self.low == 0:
            least = "must be positive" if self.above else f"is negative; it {least}"
        raise ValueError(f"{shown(value)} {least}")


class OneOf:
    """The texts that a setting may be."""

    def __init__(self, *valid: str):
        self._valid = valid

    def check(self, value: str) -> None:
        """Raises ``ValueError`` for another text."""
        if value not in self._valid:
            raise ValueError(f"{shown(value)} is unknown; choose from {', '.join(self._valid)}")


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
    """Plain values as a dataclass, or another type that fields may have.

    There may be no other keys than the dataclass has. ``path`` says in errors where they stand.

    Raises:
        ValueError: names every key that is wrong, and why.
    """
    wrong: list[str] = []
    found = _collected(values, kind, path, wrong)
    if wrong:
        raise ValueError("; ".join(wrong))
    return found


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
    """A value as one short line, for errors."""
    text = printable(repr(value))
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def check_names(key: str, names: Sequence[str], valid: Sequence[str]) -> None:
    """Raises ``ValueError`` for an unknown or repeated name in a setting."""
    for name in names:
        if name not in valid:
            raise ValueError(f"{key}: {name!r} is unknown; choose from {', '.join(valid)}")
    if len(set(names)) < len(names):
        raise ValueError(f"{key}: {', '.join(names)} names one twice")


def _collected(value: Any, kind: Any, path: str, wrong: list[str]) -> Any:
    """A value as its kind; what is wrong is added to the list, a line for each key."""
    try:
        return _made(value, kind, path, wrong)
    except ValueError as error:
        # What a dataclass says of its own fields may name the key already.
        is_named = not path or str(error).startswith(path.split(".")[0])
        wrong.append(str(error) if is_named else f"{path}: {error}")
        return None


def _made(value: Any, kind: Any, path: str, wrong: list[str]) -> Any:
    """The same; raises ``ValueError`` for what is wrong with the value as a whole."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        found = _made(value, inner[0], path, wrong)
        inner[1].check(found)
        return found
    if is_dataclass(kind):
        return _instance(value, kind, path, wrong)
    if type(None) in inner:
        (other,) = (one for one in inner if one is not type(None))
        return None if value is None else _made(value, other, path, wrong)
    if origin is tuple:
        return _row(value, inner, path, wrong)
    if origin in (Mapping, dict):
        return _keys(value, inner[1], path, wrong)
    if kind is Any:
        return _anything(value, path, wrong)
    return _PLAIN[kind](value)


def _instance(value: Any, kind: Any, path: str, wrong: list[str]) -> Any:
    """A dataclass from a mapping."""
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"{shown(value)} has no keys")
    hints = _hints(kind)
    odd = [shown(key)[1:-1] for key in value if key not in hints]
    lacking = [f.name for f in fields(kind) if f.default is MISSING and f.name not in value]
    if odd or lacking:
        what = f"unknown key {odd[0]}" if odd else f"{lacking[0]} is missing"
        raise ValueError(f"{what}; its keys are {', '.join(hints)}")
    before = len(wrong)
    found = {
        key: _collected(one, hints[key], f"{path}.{key}" if path else key, wrong)
        for key, one in value.items()
    }
    return None if len(wrong) > before else kind(**found)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """The types of a dataclass's fields, with their ranges."""
    found = get_type_hints(kind, include_extras=True)
    return {f.name: found[f.name] for f in fields(kind)}


def _row(value: Any, kinds: tuple[Any, ...], path: str, wrong: list[str]) -> tuple[Any, ...]:
    """``tuple[kind, ...]``, or as many values as a tuple has kinds; names also as ``a,b``."""
    are_names = kinds == (str, Ellipsis)
    if are_names and isinstance(value, str):
        value = value.split(",")
    if not isinstance(value, list | tuple):
        raise ValueError(f"{shown(value)} is no list{' of names' if are_names else ''}")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        raise ValueError(f"{shown(value)} must be {len(kinds)} values")
    return tuple(_made(one, kind, path, wrong) for one, kind in zip(value, kinds, strict=True))


def _keys(value: Any, kind: Any, path: str, wrong: list[str]) -> dict[str, Any]:
    """``Mapping[str, kind]``."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{shown(value)} has no keys")
    found = {}
    for key, one in value.items():
        name = shown(key)[1:-1]
        below = f"{path}.{name}" if path else name
        found[_collected(key, str, below, wrong)] = _collected(one, kind, below, wrong)
    return found


def _anything(value: Any, path: str, wrong: list[str]) -> Any:
    """Any plain value, with all in it finite."""
    if isinstance(value, Mapping):
        return _keys(value, Any, path, wrong)
    if isinstance(value, list | tuple):
        return [_anything(one, path, wrong) for one in value]
    if isinstance(value, str):
        return _text(value, _LONGEST_PROGRAM)
    return _number(value) if isinstance(value, float) else value


def _whole_number(value: Any) -> int:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or (isinstance(value, float) and not value.is_integer()):
        raise ValueError(f"{shown(value)} is not a whole number")
    return int(value)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{shown(value)} is not a number")
    # Before it is one: there are whole numbers that no float can hold.
    if not abs(value) <= 1.7e308:
        raise ValueError(f"{shown(value)} is not finite")
    return float(value)


def _truth(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{shown(value)} is not true or false")
    return value


def _text(value: Any, longest: int = _LONGEST) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{shown(value)} is not a text")
    if printable(value) != value:
        raise ValueError(f"{shown(value)} has control characters")
    if len(value) > longest:
        raise ValueError(f"{shown(value)} is too long")
    return value


_PLAIN: dict[Any, Any] = {int: _whole_number, float: _number, bool: _truth, str: _text}
