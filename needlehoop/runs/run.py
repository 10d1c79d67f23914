"""The files of a run: a folder that stays readable whatever happens to its process."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import yaml

from needlehoop.runs.files import (
    CHECKPOINT,
    CONFIG,
    EVALUATIONS,
    MANIFEST,
    METRICS,
    REWARD,
    set_aside,
    write_whole,
)
from needlehoop.runs.machine import provenance
from needlehoop.runs.reading import read_json, read_yaml

_TABLES = (METRICS, EVALUATIONS)

_BORN = {CONFIG, MANIFEST, REWARD}
"""The files of a run that has only begun."""


class Run:
    """A run's folder. A process that writes into it holds its lock (``held``)."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._former: Path | None = None
        self._is_new = False
        # The tables are cut back to these sizes before the next row.
        self._sizes: dict[str, int] | None = None

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
        # Made beside its place and renamed when it is whole. A killed process may have left one.
        unborn = folder.with_name(f".{folder.name}.new")
        shutil.rmtree(unborn, ignore_errors=True)
        unborn.mkdir(parents=True)
        run = cls(unborn)
        write_whole(unborn / REWARD, reward)
        write_whole(unborn / CONFIG, yaml.safe_dump(dict(config), sort_keys=False))
        run.note(**provenance(), wall_time=0.0, steps=0, stopped=False, finished=False)
        run._former = set_aside(folder) if names else None
        unborn.rename(folder)
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
        """A run that exists; ``ValueError``, with the setting ``key``, where there is none."""
        if not (folder / CONFIG).is_file():
            raise ValueError(f"{f'{key}: ' if key else ''}{folder} is no run: it has no {CONFIG}")
        return cls(folder)

    def config(self) -> dict[str, Any]:
        """The composed config that the run began with; ``ValueError`` if the file is damaged."""
        return read_yaml(self.folder / CONFIG)

    def manifest(self) -> dict[str, Any]:
        """Versions, commit, machine, times; empty if there is none, ``ValueError`` if damaged."""
        path = self.folder / MANIFEST
        return read_json(path) if path.exists() else {}

    def note(self, **facts: Any) -> None:
        """Add to the manifest."""
        text = json.dumps({**self.manifest(), **facts}, indent=2)
        write_whole(self.folder / MANIFEST, text + "\n")

    def append(self, table: str, row: Mapping[str, Any]) -> None:
        """Add a row to a table and see that it is on the disk; NaN and ``None`` are empty cells.

        A table keeps the columns that it began with; ``RuntimeError`` if the row lacks one.
        """
        self._cut_back()
        path = self.folder / table
        columns: list[str] = []
        if path.exists():
            with path.open(newline="", encoding="utf-8") as file:
                columns = next(csv.reader(file), [])
        if missing := [name for name in columns if name not in row]:
            raise RuntimeError(f"{path}: the row lacks {', '.join(missing)}")
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            if not columns:
                writer.writerow(row)
            writer.writerow(_cell(row[name]) for name in columns or row)
            file.flush()
            # The checkpoint after it counts on the row.
            os.fsync(file.fileno())

    def rows(self, table: str) -> list[dict[str, str]]:
        """The rows of a table; none where it has not begun."""
        path = self.folder / table
        if not path.exists():
            return []
        with path.open(newline="", encoding="utf-8") as file:
            return [*csv.DictReader(file)]

    def save(self, state: Mapping[str, Any]) -> None:
        """Write the checkpoint, whole or not at all, with the bytes of each table."""
        self._cut_back()
        sizes = {name: self._size(name) for name in _TABLES}
        buffer = io.BytesIO()
        torch.save({**state, "tables": sizes}, buffer)
        write_whole(self.folder / CHECKPOINT, buffer.getvalue())

    def checkpoint(self) -> dict[str, Any]:
        """The last checkpoint, on the CPU; a foreign file can't run anything here.

        Raises ``ValueError`` where there is none, or it is damaged.
        """
        path = self.folder / CHECKPOINT
        if not path.exists():
            raise ValueError(
                f"{self.folder} has no {CHECKPOINT}: it ended before the first one (or was copied"
                " without it), and nothing can go on from there"
            )
        try:
            return torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:
            # Damaged bytes make an unpickler raise any kind of error.
            raise ValueError(f"{path} is damaged: cut off, or something else") from error

    def go_on(self, checkpoint: Mapping[str, Any] | None) -> None:
        """Go on from a checkpoint, or from the beginning where there is none.

        The rows after it are made again. They stay until then, because a run that is refused
        keeps what it has. Raises ``ValueError`` where a table has lost rows since.
        """
        self._sizes = sizes = checkpoint["tables"] if checkpoint else {}
        for name, size in sizes.items():
            if self._size(name) < size:
                raise ValueError(f"{self.folder / name} has lost rows since {CHECKPOINT}")

    def _cut_back(self) -> None:
        if self._sizes is None:
            return
        for name in _TABLES:
            if size := self._sizes.get(name, 0):
                os.truncate(self.folder / name, size)
            else:
                (self.folder / name).unlink(missing_ok=True)
        self._sizes = None

    def _size(self, name: str) -> int:
        path = self.folder / name
        return path.stat().st_size if path.exists() else 0

    def write(self, name: str, text: str) -> Path:
        """Write a small file, whole or not at all; another text of that name is kept.

        Its name may begin with that of a folder in the run's, which is made.
        """
        path = self.folder / name
        if not (path.exists() and path.read_bytes() == text.encode()):
            write_whole(self.vacate(name), text)
        return path

    def vacate(self, name: str) -> Path:
        """The path of a file to be written; ``name.ext`` that is there becomes ``name.1.ext``."""
        path = self.folder / name
        set_aside(path)
        return path


def _cell(value: Any) -> Any:
    """Numbers with nine digits, which bring a float32 back to the bit."""
    if value is None or value != value:
        return ""
    return format(value, ".9g") if isinstance(value, float) else value
