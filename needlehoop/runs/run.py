"""The files of a run: a folder that stays readable whatever happens to its process."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
import yaml

from needlehoop.runs.files import (
    CHECKPOINT,
    CONFIG,
    EVALUATIONS,
    MANIFEST,
    METRICS,
    REWARD,
    csv_text,
    naming,
    set_aside,
    write_whole,
)
from needlehoop.runs.machine import provenance
from needlehoop.runs.reading import TABLE, UnreadableError, named, read_bytes, read_json, read_yaml

_TABLES = (METRICS, EVALUATIONS)

_BORN = {CONFIG, MANIFEST, REWARD}
"""The files of a run that has only begun."""

_LARGEST = 8_000_000_000
"""Bytes of a checkpoint, at most."""

ADVICE = (
    "put it back, or begin the run again with overwrite=true, which keeps this one under a number"
)
"""What to do about a damaged file of a run."""


class Checkpoint(NamedTuple):
    """The training's tensors and plain values, the run's settings, each table's text by file."""

    state: dict[str, Any]
    config: dict[str, Any]
    tables: dict[str, str]


class Run:
    """A run's folder. Who writes into it does so while it is ``held``.

    Args:
        config: the composed config that the run began with; by default what its file says.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any] | None = None):
        self.folder = folder
        self._config = None if config is None else dict(config)
        # What was written of each table, from which a damaged file is restored.
        self._tables: dict[str, str] = dict.fromkeys(_TABLES, "")
        self._is_settled = True
        self._former: Path | None = None
        self._is_new = False

    @classmethod
    def create(cls, folder: Path, config: Mapping[str, Any], reward: str, overwrite: bool) -> Run:
        """Begin a run in a new folder: config, reward's text, manifest; all of it or nothing.

        With ``overwrite``, a run that is there is kept under a number, with all in its folder.

        Raises:
            ValueError: the folder has something in it, and ``overwrite`` is false, or what is
                in it is no run.
        """
        names = {path.name for path in folder.iterdir()} if folder.exists() else set()
        if names and not overwrite:
            raise ValueError(
                f"{folder} exists; go on with resume={folder}, or begin again with overwrite=true,"
                " which keeps it under a number, or choose another label= or study="
            )
        if names and CONFIG not in names:
            raise ValueError(f"overwrite: {folder} holds files but no run; move them away")
        # Made beside its place, and renamed when it is whole. One left there is of a dead process.
        unborn = folder.with_name(f".{folder.name}.new")
        shutil.rmtree(unborn, ignore_errors=True)
        unborn.mkdir(parents=True)
        run = cls(unborn, config)
        try:
            write_whole(unborn / REWARD, reward)
            run.note(**provenance(), wall_time=0.0, steps=0, stopped=False, finished=False)
            text = yaml.dump(dict(config), Dumper=_Plain, sort_keys=False)
            write_whole(unborn / CONFIG, text)
            run._former = set_aside(folder) if names else None
            unborn.rename(folder)
        except BaseException:
            shutil.rmtree(unborn, ignore_errors=True)
            raise
        run.folder, run._is_new = folder, True
        return run

    def unmake(self) -> None:
        """Remove a new run that ended before it wrote anything, and put back what it replaced."""
        if self._is_new and {path.name for path in self.folder.iterdir()} <= _BORN:
            shutil.rmtree(self.folder)
            if self._former is not None:
                self._former.rename(self.folder)

    @classmethod
    def open(cls, folder: Path, key: str | None = None) -> Run:
        """A run that exists; ``key`` names the setting that says which, for errors.

        Raises:
            ValueError: no run there.
        """
        if not (folder / CONFIG).is_file():
            raise ValueError(f"{f'{key}: ' if key else ''}{folder} is no run: it has no {CONFIG}")
        return cls(folder)

    def config(self) -> dict[str, Any]:
        """The composed config that the run began with.

        Raises:
            ValueError: the file is damaged.
        """
        if self._config is None:
            path = self.folder / CONFIG
            with named(path, ADVICE):
                self._config = read_yaml(path)
        return self._config

    def manifest(self) -> dict[str, Any]:
        """Versions, commit, machine, times; empty where there is none.

        Raises:
            ValueError: the file is damaged.
        """
        path = self.folder / MANIFEST
        with named(path, ADVICE):
            return read_json(path) if path.exists() else {}

    def note(self, **facts: Any) -> None:
        """Add to the manifest."""
        text = json.dumps({**self.manifest(), **facts}, indent=2)
        write_whole(self.folder / MANIFEST, text + "\n")

    def append(self, table: str, row: Mapping[str, Any]) -> None:
        """Add a row to a table and see that it is on the disk; NaN and ``None`` are empty cells.

        A table keeps the columns that it began with.

        Raises:
            RuntimeError: the row lacks a column of the table's.
        """
        if not self._is_settled:
            self._settle()
        path, text = self.folder / table, self._tables[table]
        columns = next(csv.reader(io.StringIO(text)), [*row])
        if not set(columns) <= set(row):
            raise RuntimeError(f"{path}: columns {columns}; the row has {list(row)}")
        cells = [_cell(row[name]) for name in columns]
        added = csv_text(cells, []) if text else csv_text(columns, [cells])
        with naming(path), path.open("ab") as file:
            file.write(added.encode())
            file.flush()
            os.fsync(file.fileno())
        self._tables[table] += added

    def rows(self, table: str) -> list[dict[str, str]]:
        """The rows of a table that this run goes on with, and those added since."""
        return [*csv.DictReader(io.StringIO(self._tables[table]))]

    def save(self, state: Mapping[str, Any]) -> None:
        """Write the checkpoint, whole or not at all, and with it the tables as they are."""
        self._settle()
        own = {"config": self.config(), "tables": self._tables}
        write_checkpoint(self.folder / CHECKPOINT, {**state, **own})

    def checkpoint(self) -> Checkpoint:
        """The last checkpoint; a foreign file can't run anything here.

        Raises:
            ValueError: there is none, or it is damaged.
        """
        path = self.folder / CHECKPOINT
        if not path.exists():
            raise ValueError(
                f"{self.folder} has no {CHECKPOINT}: it ended before the first one (or was copied"
                " without it), and nothing can go on from there"
            )
        with named(path, ADVICE):
            return _read_checkpoint(path)

    def go_on(self, checkpoint: Checkpoint | None) -> None:
        """Go on with the tables as a checkpoint has them; with none where there is none.

        Before the next row the files are cut back to it: the rows after the checkpoint are made
        again. A file that differs otherwise is kept under a number, and a line says so.
        """
        texts = checkpoint.tables if checkpoint else {}
        self._tables = {name: texts.get(name, "") for name in _TABLES}
        self._is_settled = False

    def finish(self) -> None:
        """Note that all is done, and see that the tables are whole."""
        self._settle()
        self.note(finished=True)

    def write(self, name: str, text: str) -> Path:
        """Write a small file, whole or not at all; another text of that name is kept.

        Its name may begin with that of a folder in the run's, which is made.
        """
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not (path.exists() and path.read_bytes() == text.encode()):
            write_whole(self.vacate(name), text)
        return path

    def replace(self, name: str, text: str) -> None:
        """Write a small file, whole or not at all, over what is there."""
        write_whole(self.folder / name, text)

    def vacate(self, name: str) -> Path:
        """The path of a file to be written; ``name.ext`` that is there becomes ``name.1.ext``."""
        path = self.folder / name
        set_aside(path)
        return path

    def _settle(self) -> None:
        """Bring the tables' files to what was written of them.

        Later rows are cut off: they are made again. A file that differs otherwise is kept under a
        number and replaced, and a line says so.
        """
        self._is_settled = True
        for name, text in self._tables.items():
            path, own = self.folder / name, text.encode()
            try:
                found = read_bytes(path, len(own) + TABLE) if path.exists() else b""
            except UnreadableError:
                # A pipe in the file's place, say: it is set aside as well.
                found = None
            if found == own:
                continue
            if found is not None and found.startswith(own):
                if own:
                    with naming(path):
                        os.truncate(path, len(own))
                else:
                    path.unlink()
                continue
            kept = set_aside(path)
            write_whole(path, own)
            where = f"; what was there is kept as {kept.name}" if kept else ""
            print(f"{path} was damaged, and is whole again{where}", file=sys.stderr)


def _cell(value: Any) -> Any:
    """Numbers with nine digits, which bring a float32 back to the bit."""
    if isinstance(value, float):
        return "" if value != value else format(value, ".9g")
    return "" if value is None else value


def write_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file, whole or not at all; torch gives each of its parts a CRC-32."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_whole(path, buffer.getvalue())


def _read_checkpoint(path: Path) -> Checkpoint:
    """What is in a file, on the CPU; a foreign one can't run anything here.

    Raises ``UnreadableError`` for one that is damaged, even by a single bit, or no checkpoint.
    """
    data = io.BytesIO(read_bytes(path, _LARGEST))
    try:
        with zipfile.ZipFile(data) as parts:
            # torch writes the sums and does not look at them.
            spoilt = parts.testzip()
        data.seek(0)
        found = None if spoilt else torch.load(data, map_location="cpu", weights_only=True)
    except Exception as error:
        # Whatever an unpickler can trip over: other bytes fail in ways of their own.
        raise UnreadableError("is damaged: cut off, or something else") from error
    if spoilt is not None:
        raise UnreadableError(f"is damaged: the sum of {spoilt} is another")
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


class _Plain(yaml.SafeDumper):
    """Writes repeated values in full: aliases are not read back."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
