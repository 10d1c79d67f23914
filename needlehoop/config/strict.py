"""The one converter: from plain values, as a config has them, to what a dataclass's fields say.

It guesses nothing: no text for a number, no ``off`` for false, no NaN, no ``None`` for a name.
A field's type has its range: ``steps: Annotated[int, Range(1)]``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import cattrs

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
        if value > self.low or (value == self.low and not self.above):
            if value <= self.high:
                return
            raise ValueError(f"{shown(value)} must be at most {self.high:g}")
        if (self.low, self.above) == (0, True):
            raise ValueError(f"{shown(value)} must be positive")
        if self.low == 0:
            raise ValueError(f"{shown(value)} is negative; it must be at least 0")
        raise ValueError(
            f"{shown(value)} must be {'above' if self.above else 'at least'} {self.low:g}"
        )


_MANY = 1_000_000_000

Count = Annotated[int, Range(1, _MANY)]
"""A count of at least 1."""

Number = Annotated[int, Range(0, _MANY)]
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


class _BelowError(ValueError):
    """Errors in a mapping: a line each, which begins with the keys that lead there."""

    def __init__(self, lines: list[str]):
        super().__init__("; ".join(lines))
        self.lines = lines


def structure(values: Any, kind: Any, path: str = "") -> Any:
    """Plain values as a dataclass, or another type that fields may have.

    Args:
        values: keys and values; there may be no other keys than the dataclass has.
        kind: the dataclass.
        path: where the values stand in the config, for errors.

    Raises:
        ValueError: names every key that is wrong, and why.
    """
    try:
        return _converter.structure(values, kind)
    except (cattrs.BaseValidationError, ValueError) as error:
        raise ValueError("; ".join(_flatten(error, path))) from error


def as_type(values: Mapping[str, Any], kind: type[T], path: str = "") -> T:
    """The values that a dataclass names, as one; errors as in ``structure``.

    Args:
        values: of a composed config; with a ``path`` there may be no others.
        kind: the dataclass.
        path: where the values stand in the config.
    """
    if path:
        return structure(values, kind, path)
    names = getattr(kind, "__dataclass_fields__", {})
    return structure({name: values[name] for name in names}, kind)


def value(values: Mapping[str, Any], key: str, kind: Any) -> Any:
    """One value of a composed config: a whole number, a truth, a text, a list of names, …

    Raises:
        ValueError: it is something else; says the key.
    """
    return structure(values[key], kind, key)


def _flatten(error: BaseException, path: str = "") -> Iterable[str]:
    """One line per invalid value, named by its key."""
    if isinstance(error, cattrs.IterableValidationError | cattrs.ClassValidationError):
        notes = {id(inner): note for inner, note in error.group_exceptions()[0]}
        for inner in error.exceptions:
            note = notes.get(id(inner))
            name = str(getattr(note, "name", getattr(note, "index", ""))) if note else ""
            yield from _flatten(inner, f"{path}.{name}" if path and name else path or name)
    elif isinstance(error, _BelowError):
        yield from (f"{path}.{line}" if path else line for line in error.lines)
    elif path and not str(error).startswith(path.split(".")[0]):
        yield f"{path}: {error}"
    else:
        yield str(error)


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


def _whole_number(value: Any, _: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{shown(value)} is not a whole number")
    if isinstance(value, float) and not value.is_integer():
        raise ValueError(f"{shown(value)} is not a whole number")
    return int(value)


def _number(value: Any, _: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{shown(value)} is not a number")
    # Before it is one: there are whole numbers that no float can hold.
    if not abs(value) <= 1.7e308:
        raise ValueError(f"{shown(value)} is not finite")
    return float(value)


def _truth(value: Any, _: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{shown(value)} is not true or false")
    return value


def _text(value: Any, _: Any, longest: int = _LONGEST) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{shown(value)} is not a text")
    if printable(value) != value:
        raise ValueError(f"{shown(value)} has control characters")
    if len(value) > longest:
        raise ValueError(f"{shown(value)} is too long")
    return value


def _maybe(value: Any, kind: Any) -> Any:
    """``kind | None``, the kind strictly."""
    (other,) = (one for one in get_args(kind) if one is not type(None))
    return None if value is None else _converter.structure(value, other)


def _by_kind(value: Any, union: Any) -> Any:
    """A union of two dataclasses: values with a ``kind`` are of the one that has that field."""
    named = isinstance(value, Mapping) and "kind" in value
    (own,) = (one for one in get_args(union) if ("kind" in one.__dataclass_fields__) is named)
    return _converter.structure(value, own)


def _names(value: Any, _: Any) -> tuple[str, ...]:
    """A list of names, also as one text with commas."""
    names = value.split(",") if isinstance(value, str) else value
    if not isinstance(names, list | tuple):
        raise ValueError(f"{shown(value)} is no list of names")
    return tuple(_text(name, str) for name in names)


def _row(value: Any, kind: Any) -> tuple[Any, ...]:
    """``tuple[kind, ...]``, or as many values as a tuple has kinds."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"{shown(value)} is no list")
    kinds = get_args(kind)
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        raise ValueError(f"{shown(value)} must be {len(kinds)} values")
    return tuple(_converter.structure(one, k) for one, k in zip(value, kinds, strict=True))


def _keys(value: Any, kind: Any) -> dict[str, Any]:
    """``Mapping[str, kind]``."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{shown(value)} has no keys")
    _, inner = get_args(kind)
    found = {}
    for key, one in value.items():
        try:
            found[_text(key, str)] = _converter.structure(one, inner)
        except (cattrs.BaseValidationError, ValueError) as error:
            raise _BelowError(list(_flatten(error, shown(key)[1:-1]))) from error
    return found


def _anything(value: Any, _: Any) -> Any:
    """Any plain value, with all in it finite."""
    if isinstance(value, Mapping):
        return _keys(value, Mapping[str, Any])
    if isinstance(value, list | tuple):
        return [_anything(one, Any) for one in value]
    if isinstance(value, str):
        return _text(value, str, _LONGEST_PROGRAM)
    if isinstance(value, float):
        return _number(value, float)
    return value


def _ranged(value: Any, kind: Any) -> Any:
    base, *notes = get_args(kind)
    found = _converter.structure(value, base)
    for note in notes:
        note.check(found)
    return found


def _keyed(kind: Any) -> Any:
    """The hook that makes a dataclass from a mapping."""
    # cattrs reads the types of fields without what is annotated to them.
    hints = get_type_hints(kind, include_extras=True)
    hooks: Any = {
        f.name: cattrs.gen.override(
            struct_hook=lambda value, _, own=hints[f.name]: _one(value, own)
        )
        for f in fields(kind)
    }
    needed = [f.name for f in fields(kind) if f.default is MISSING]
    made = cattrs.gen.make_dict_structure_fn(
        kind, _converter, _cattrs_forbid_extra_keys=True, **hooks
    )

    def hook(value: Any, _: Any) -> Any:
        if isinstance(value, kind):
            return value
        if not isinstance(value, Mapping):
            raise ValueError(f"{shown(value)} has no keys")
        odd = [shown(key)[1:-1] for key in value if key not in hooks]
        lacking = [key for key in needed if key not in value]
        if odd or lacking:
            what = f"unknown key {odd[0]}" if odd else f"{lacking[0]} is missing"
            raise ValueError(f"{what}; its keys are {', '.join(hooks)}")
        return made(value, kind)

    return hook


def _one(value: Any, kind: Any) -> Any:
    return _converter.structure(value, kind)


def _is(origin: Any) -> Any:
    return lambda kind: get_origin(kind) is origin


_converter = cattrs.Converter(forbid_extra_keys=True)
_converter.register_structure_hook(int, _whole_number)
_converter.register_structure_hook(float, _number)
_converter.register_structure_hook(bool, _truth)
_converter.register_structure_hook(str, _text)
_converter.register_structure_hook_func(lambda kind: kind is Any, _anything)
_converter.register_structure_hook_func(_is(tuple), _row)
_converter.register_structure_hook_func(lambda kind: kind == tuple[str, ...], _names)
_converter.register_structure_hook_func(lambda kind: get_origin(kind) in (Mapping, dict), _keys)
_converter.register_structure_hook_func(
    lambda kind: type(None) in get_args(kind) and len(get_args(kind)) == 2, _maybe
)
_converter.register_structure_hook_func(_is(Annotated), _ranged)
_converter.register_structure_hook_func(
    lambda kind: len(get_args(kind)) == 2 and all(map(is_dataclass, get_args(kind))), _by_kind
)
_converter.register_structure_hook_factory(is_dataclass, _keyed)
