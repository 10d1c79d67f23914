"""How files are read back: text, JSON and YAML, with one error for whatever is damaged."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

# libyaml's loader is ten times as fast, where it was built in.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Control characters except tab and line feed."""


class UnreadableError(ValueError):
    """A file that cannot be read; the message names it and says why."""


def read_text(path: Path) -> str:
    """A text in UTF-8; ``UnreadableError`` if it can't be opened, is empty or no text."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableError(f"{path} can't be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UnreadableError(f"{path} is no text") from error
    if not text.strip():
        raise UnreadableError(f"{path} is empty")
    return text


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; ``UnreadableError`` as in ``read_text``, or if it is something else."""
    return _read(path, json.loads, "JSON")


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping; ``UnreadableError`` as in ``read_text``, or if it is something else."""
    return _read(path, lambda text: yaml.load(text, _LOADER), "YAML")


def _read(path: Path, parse: Callable[[str], Any], kind: str) -> dict[str, Any]:
    text = read_text(path)
    try:
        values = parse(text)
    except (json.JSONDecodeError, yaml.YAMLError) as error:
        raise UnreadableError(f"{path} is no {kind}, or cut off") from error
    if not isinstance(values, dict):
        raise UnreadableError(f"{path} holds no keys")
    return values


def printable(text: str) -> str:
    r"""A text for a terminal: control characters are written out, such as ``\x1b``."""
    return _CONTROL.sub(lambda match: ascii(match[0])[1:-1], text)
