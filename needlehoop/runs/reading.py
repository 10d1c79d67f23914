"""How files are read back: text, JSON and YAML, with one error for whatever is damaged."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

# libyaml's loader is ten times as fast, where it was built in.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Control characters except tab and line feed."""


class UnreadableError(ValueError):
    """A file that cannot be read; the message says why, without the file's name."""


@contextmanager
def named(file: Any) -> Iterator[None]:
    """Turns an ``UnreadableError`` into a ``ValueError`` that names the file."""
    try:
        yield
    except UnreadableError as error:
        raise ValueError(f"{file} {error}") from error


def read_text(path: Path) -> str:
    """A text in UTF-8; ``UnreadableError`` if it can't be opened, is empty or no text."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableError(f"can't be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UnreadableError("is no text") from error
    if not text.strip():
        raise UnreadableError("is empty")
    return text


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; ``UnreadableError`` as in ``read_text``, or if it is something else."""
    text = read_text(path)
    try:
        return _keys(json.loads(text))
    except json.JSONDecodeError as error:
        raise UnreadableError("is no JSON, or cut off") from error


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping; ``UnreadableError`` as in ``read_text``, or if it is something else."""
    try:
        return _keys(yaml.load(read_text(path), _LOADER))
    except yaml.YAMLError as error:
        raise UnreadableError("is no YAML, or cut off") from error


def _keys(found: Any) -> dict[str, Any]:
    if not isinstance(found, dict) or not all(isinstance(key, str) for key in found):
        raise UnreadableError("holds no keys")
    return found


def printable(text: str) -> str:
    r"""A text for a terminal: control characters are written out, such as ``\x1b``."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)
