"""Files that others may have written: plain ones, of a bounded size, in a bounded depth.

Everything that is read back goes through here, so that a pipe, a device, 3 GB or a bomb of YAML
aliases costs a line of text and no more.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

TEXT = 1_000_000
"""Bytes of a text, at most: a program, notes, settings."""

TABLE = 8_000_000
"""Of a table: 25,000 rows of a run's metrics."""

RECORD = 256_000_000
"""Of a transcript, whose pictures are beside it."""

_YAML = 256_000
"""Of YAML, which takes longer to read; a run's settings have 7,000."""

_DEPTH = 64
"""Levels of lists and keys within each other."""

# libyaml's is ten times as fast, where it was built in.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_COMMANDS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but for tab and line feed, turns of direction, and halves of characters."""


class UnreadableError(ValueError):
    """A file that is not what its name says; the message says why, without its name."""


@contextmanager
def named(file: Any, advice: str = "") -> Iterator[None]:
    """Turns an ``UnreadableError`` into a ``ValueError`` that begins with the file.

    ``file``: its path, or a text with its key. ``advice``: what to do, after a semicolon.
    """
    try:
        yield
    except UnreadableError as error:
        raise ValueError(f"{file} {error}{advice and f'; {advice}'}") from error


def read_bytes(path: Path, most: int = TEXT, within: Path | None = None) -> bytes:
    """What is in a plain file of at most ``most`` bytes.

    It must lie in the folder ``within``, also where it is a link.

    Raises:
        UnreadableError: it is something else, too large, elsewhere, or can't be opened.
    """
    try:
        if within is not None and not path.resolve().is_relative_to(within.resolve()):
            raise UnreadableError(f"is a link out of {within}")
    except (OSError, RuntimeError) as error:
        raise UnreadableError("is a link to itself") from error
    try:
        # Not blocking: a pipe that nobody writes to would wait for ever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(descriptor, "rb") as file:
            state = os.fstat(descriptor)
            is_plain = stat.S_ISREG(state.st_mode)
            # Some plain files, such as those of /proc, have more in them than they say.
            data = file.read(most + 1) if is_plain and state.st_size <= most else b""
    except (OSError, ValueError) as error:
        # ValueError: its name has a null character.
        raise UnreadableError(f"can't be read: {getattr(error, 'strerror', error)}") from error
    if not is_plain:
        raise UnreadableError("is no plain file")
    if max(state.st_size, len(data)) > most:
        raise UnreadableError(f"is larger than {most:,} bytes")
    return data


def check_plain(path: Path) -> None:
    """Raises ``UnreadableError`` for a pipe, a device or a folder: before a library opens it."""
    if path.exists() and not path.is_file():
        raise UnreadableError("is no plain file")


def read_text(path: Path, most: int = TEXT, within: Path | None = None) -> str:
    """A text in UTF-8; ``UnreadableError`` as in ``read_bytes``, or if it is empty or no text."""
    try:
        text = read_bytes(path, most, within).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UnreadableError("is no text") from error
    if not text.strip():
        raise UnreadableError("is empty")
    return text


def read_json(path: Path, most: int = TEXT, within: Path | None = None) -> dict[str, Any]:
    """A JSON object; ``UnreadableError`` as in ``read_text``, or if it is something else."""
    return _keys(parse_json(read_text(path, most, within)))


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text; ``UnreadableError`` if it is none, too deep, or not finite."""
    try:
        found = json.loads(text, parse_constant=_number, parse_float=_number)
    except UnreadableError:
        raise
    except (ValueError, RecursionError) as error:
        raise UnreadableError("is no JSON, or cut off") from error
    _check_depth(found)
    return found


def read_yaml(path: Path, within: Path | None = None) -> dict[str, Any]:
    """A YAML mapping; ``UnreadableError`` as in ``read_text``, or if it is something else."""
    text = read_text(path, _YAML, within)
    try:
        depth = 0
        for event in yaml.parse(text, Loader=_LOADER):
            # A few make billions of values.
            if isinstance(event, yaml.AliasEvent):
                raise UnreadableError("has YAML aliases")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEPTH:
                raise UnreadableError("is too deep")
        found = yaml.load(text, _LOADER)
    except UnreadableError:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UnreadableError("is no YAML, or cut off") from error
    return _keys(found)


def _check_depth(value: Any, depth: int = 0) -> None:
    """Raises ``UnreadableError`` for lists and keys too deep within each other."""
    if depth > _DEPTH:
        raise UnreadableError("is too deep")
    if isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            _check_depth(inner, depth + 1)


def _keys(found: Any) -> dict[str, Any]:
    if not isinstance(found, dict) or not all(isinstance(key, str) for key in found):
        raise UnreadableError("holds no keys")
    return found


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise UnreadableError(f"has {text}, which is no JSON")
    return value


def printable(text: str) -> str:
    r"""A text for a terminal: control characters are written out, such as ``\x1b``."""
    return _COMMANDS.sub(lambda found: ascii(found[0])[1:-1], text)
