"""Checkpoints as files: the state of a training, its settings, and its tables at that moment."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from needlehoop.runs.files import write_whole
from needlehoop.runs.reading import UnreadableError, read_bytes

_LARGEST = 8_000_000_000


@dataclass(frozen=True)
class Checkpoint:
    """What a file holds beside the training's own ``state``."""

    state: dict[str, Any]
    """Tensors and plain values."""
    config: dict[str, Any]
    """The run's settings."""
    tables: dict[str, str]
    """The text of each table, by the name of its file."""


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a file, whole or not at all; torch gives each of its parts a CRC-32."""
    buffer = io.BytesIO()
    own = {"config": checkpoint.config, "tables": checkpoint.tables}
    torch.save({**checkpoint.state, **own}, buffer)
    write_whole(path, buffer.getvalue())


def read_checkpoint(path: Path) -> Checkpoint:
    """What is in a file, on the CPU; a foreign one can't run anything here.

    Raises:
        UnreadableError: it is damaged, even by a single bit, or no checkpoint.
    """
    data = io.BytesIO(read_bytes(path, _LARGEST))
    try:
        with zipfile.ZipFile(data) as parts:
            # torch writes the sums and does not look at them.
            spoilt = parts.testzip()
        if spoilt is not None:
            raise UnreadableError(f"is damaged: the sum of {spoilt} is another")
        data.seek(0)
        found = torch.load(data, map_location="cpu", weights_only=True)
    except UnreadableError:
        raise
    except Exception as error:
        # Whatever an unpickler can trip over: other bytes fail in ways of their own.
        raise UnreadableError("is damaged: cut off, or something else") from error
    if not isinstance(found, dict):
        raise UnreadableError("holds no keys")
    config, tables = found.pop("config", None), found.pop("tables", None)
    if not _texts(config, object) or not _texts(tables, str):
        raise UnreadableError("is of another version: it has no settings or no tables")
    return Checkpoint(found, config, tables)


def _texts(found: Any, kind: type) -> bool:
    """Whether it is a mapping from texts to values of a kind."""
    return isinstance(found, Mapping) and all(
        isinstance(key, str) and isinstance(value, kind) for key, value in found.items()
    )
