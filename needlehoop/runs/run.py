"""The files of a run: a folder that stays readable whatever happens to its process."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from needlehoop.runs.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
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
from needlehoop.runs.reading import UnreadableError, read_json, read_yaml
from needlehoop.runs.table import Table

_TABLES = (METRICS, EVALUATIONS)
_BORN = {REWARD, MANIFEST, f"{REWARD}.partial", f"{MANIFEST}.partial", f"{CONFIG}.partial"}
"""Files of a run whose process died before its config was written."""


class Run:
    """A run's folder. Who writes into it holds its ``Lock``.

    Args:
        config: the composed config that the run began with; by default what its file says.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any] | None = None):
        self.folder = folder
        self._config = None if config is None else dict(config)
        self._tables = {name: Table(folder / name) for name in _TABLES}
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
        _check_vacant(folder, overwrite)
        # Made beside its place, and renamed when it is whole. One left there is of a dead process.
        unborn = folder.with_name(f".{folder.name}.new")
        shutil.rmtree(unborn, ignore_errors=True)
        unborn.mkdir(parents=True)
        try:
            run = cls(unborn)
            write_whole(unborn / REWARD, reward)
            run.note(**provenance(), wall_time=0.0, steps=0, stopped=False, finished=False)
            text = yaml.dump(dict(config), Dumper=_Plain, sort_keys=False)
            write_whole(unborn / CONFIG, text)
            former = set_aside(folder) if folder.exists() and any(folder.iterdir()) else None
            unborn.rename(folder)
        except BaseException:
            shutil.rmtree(unborn, ignore_errors=True)
            raise
        run = cls(folder, config)
        run._former, run._is_new = former, True
        return run

    def unmake(self) -> None:
        """Remove a new run that ended before it wrote anything, and put back what it replaced."""
        if self._is_new and {path.name for path in self.folder.iterdir()} <= {*_BORN, CONFIG}:
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
            with _reading(self.folder / CONFIG) as path:
                self._config = read_yaml(path)
        return self._config

    def manifest(self) -> dict[str, Any]:
        """Versions, commit, machine, times; empty where there is none.

        Raises:
            ValueError: the file is damaged.
        """
        with _reading(self.folder / MANIFEST) as path:
            return read_json(path) if path.exists() else {}

    def note(self, **facts: Any) -> None:
        """Add to the manifest."""
        text = json.dumps({**self.manifest(), **facts}, indent=2)
        write_whole(self.folder / MANIFEST, text + "\n")

    def append(self, table: str, row: Mapping[str, Any]) -> None:
        """Add a row to a table; NaN and ``None`` become empty cells.

        Raises:
            RuntimeError: the row's columns are not the table's.
        """
        if not self._is_settled:
            self._settle()
        self._tables[table].append(row)

    def rows(self, table: str) -> list[dict[str, str]]:
        """The rows of a table that this run goes on with, and those added since."""
        return self._tables[table].rows()

    def save(self, state: Mapping[str, Any]) -> None:
        """Write the checkpoint, whole or not at all, and with it the tables as they are."""
        self._settle()
        tables = {name: table.text for name, table in self._tables.items()}
        checkpoint = Checkpoint(dict(state), self.config(), tables)
        write_checkpoint(self.folder / CHECKPOINT, checkpoint)

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
        with _reading(path):
            return read_checkpoint(path)

    def go_on(self, checkpoint: Checkpoint | None) -> None:
        """Go on with the tables as a checkpoint has them; with none where there is none.

        Before the next row the files are cut back to it: the rows after the checkpoint are made
        again. A file that differs otherwise is kept under a number, and a line says so.
        """
        texts = checkpoint.tables if checkpoint else {}
        self._tables = {name: Table(self.folder / name, texts.get(name, "")) for name in _TABLES}
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
        self._is_settled = True
        for table in self._tables.values():
            wrong = table.settle()
            if wrong:
                print(wrong, file=sys.stderr)


def _check_vacant(folder: Path, overwrite: bool) -> None:
    """Check that a run may begin in a folder; errors as in ``Run.create``."""
    names = {path.name for path in folder.iterdir()} if folder.exists() else set()
    if names <= _BORN:
        return
    if not overwrite:
        raise ValueError(
            f"{folder} exists; go on with resume={folder}, or begin again with overwrite=true,"
            " which keeps it under a number, or choose another label= or study="
        )
    if CONFIG not in names:
        raise ValueError(f"overwrite: {folder} holds files but no run; move them away")


@contextmanager
def _reading(path: Path) -> Iterator[Path]:
    """Adds to what is wrong with a file which it is, and what to do."""
    try:
        yield path
    except UnreadableError as error:
        raise ValueError(
            f"{path} {error}; put it back, or begin the run again with overwrite=true, which keeps"
            " this one under a number"
        ) from error


class _Plain(yaml.SafeDumper):
    """Writes repeated values in full: aliases are not read back."""

    def ignore_aliases(self, data: Any) -> bool:
        return True
