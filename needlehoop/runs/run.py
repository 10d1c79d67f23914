"""The files of a run: a folder that stays readable whatever happens to its process."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import torch
import yaml

from needlehoop.runs.files import CHECKPOINT, CONFIG, MANIFEST, REWARD, write_whole
from needlehoop.runs.provenance import provenance


class Run:
    """A run's folder.

    Args:
        folder: where its files are.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    @classmethod
    def create(cls, folder: Path, config: Mapping[str, Any], reward: str, overwrite: bool) -> Run:
        """Begin a run in a new folder: config, reward's text, manifest.

        Raises:
            ValueError: the folder has something in it, and ``overwrite`` is false, or what is
                in it is no run.
        """
        if folder.exists() and any(folder.iterdir()):
            if not overwrite:
                raise ValueError(
                    f"{folder} exists; go on with resume={folder}, or replace it with"
                    " overwrite=true, or choose another study="
                )
            if not (folder / CONFIG).exists():
                raise ValueError(f"overwrite: {folder} holds files but no run; move them away")
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        run = cls(folder)
        write_whole(folder / REWARD, reward)
        run.note(**provenance(), wall_time=0.0, steps=0, stopped=False, finished=False)
        # Last: a folder with a config is a run.
        write_whole(folder / CONFIG, yaml.safe_dump(dict(config), sort_keys=False))
        return run

    @classmethod
    def open(cls, folder: Path) -> Run:
        """A run that exists.

        Raises:
            ValueError: no run there.
        """
        if not (folder / CONFIG).is_file():
            raise ValueError(f"{folder} is no run: it has no {CONFIG}")
        return cls(folder)

    def config(self) -> dict[str, Any]:
        """The composed config that the run began with.

        Raises:
            ValueError: the file is damaged.
        """
        values = _mapping(self.folder / CONFIG, yaml.safe_load)
        if isinstance(values.get("engine"), dict):
            # Runs older than the choice of a renderer were made with the tracer.
            values["engine"].setdefault("renderer", "tracer")
        return values

    def manifest(self) -> dict[str, Any]:
        """Versions, commit, machine, times; empty where there is none.

        Raises:
            ValueError: the file is damaged.
        """
        path = self.folder / MANIFEST
        return _mapping(path, json.loads) if path.exists() else {}

    def note(self, **facts: Any) -> None:
        """Add to the manifest."""
        text = json.dumps({**self.manifest(), **facts}, indent=2)
        write_whole(self.folder / MANIFEST, text + "\n")

    def append(self, table: str, row: Mapping[str, Any]) -> None:
        """Add a row to a CSV file; NaN and ``None`` become empty cells.

        Raises:
            RuntimeError: the row's columns are not the file's.
        """
        path = self.folder / table
        known = _header(path)
        if known and known != list(row):
            raise RuntimeError(f"{path}: columns {known}; the row has {list(row)}")
        with path.open("a", newline="") as file:
            writer = csv.writer(file)
            if not known:
                writer.writerow(row)
            writer.writerow(_cell(value) for value in row.values())

    def rows(self, table: str) -> list[dict[str, str]]:
        """Whole rows of a CSV file; a row torn off by a kill is left out."""
        path = self.folder / table
        if not path.exists():
            return []
        whole, _, _ = path.read_text().rpartition("\n")
        return [
            row
            for row in csv.DictReader(io.StringIO(whole))
            if None not in row and None not in row.values()
        ]

    def cut(self, table: str, update: int) -> None:
        """Drop rows after ``update``: they are about to be made again.

        Raises:
            ValueError: the file is damaged.
        """
        path = self.folder / table
        try:
            rows = [row for row in self.rows(table) if int(row["update"]) <= update]
        except (KeyError, ValueError) as error:
            raise _damaged(path) from error
        if not rows:
            path.unlink(missing_ok=True)
            return
        text = io.StringIO()
        writer = csv.DictWriter(text, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
        write_whole(path, text.getvalue())

    def save(self, state: Mapping[str, Any]) -> None:
        """Write the checkpoint, whole or not at all."""
        buffer = io.BytesIO()
        torch.save(dict(state), buffer)
        write_whole(self.folder / CHECKPOINT, buffer.getvalue())

    def load(self) -> dict[str, Any]:
        """The last checkpoint, on the CPU; a foreign file can't run anything here.

        Raises:
            ValueError: there is none, or it is damaged.
        """
        path = self.folder / CHECKPOINT
        if not path.exists():
            raise ValueError(
                f"{self.folder} has no {CHECKPOINT}: it ended before the first one (or was copied"
                " without it); begin again with overwrite=true"
            )
        try:
            return torch.load(path, map_location="cpu", weights_only=True)
        except OSError:
            raise
        except Exception as error:
            # Whatever an unpickler can trip over: other bytes fail in ways of their own.
            raise _damaged(path) from error

    def write(self, name: str, text: str) -> Path:
        """Write a small file, whole or not at all; another text of that name is kept."""
        path = self.folder / name
        if not (path.exists() and path.read_text() == text):
            write_whole(self.vacate(name), text)
        return path

    def replace(self, name: str, text: str) -> None:
        """Write a small file, whole or not at all, over what is there."""
        write_whole(self.folder / name, text)

    def vacate(self, name: str) -> Path:
        """The path of a file to be written; ``name.ext`` that is there becomes ``name.1.ext``."""
        path = self.folder / name
        if path.exists():
            taken = (path.with_stem(f"{path.stem}.{number}") for number in count(1))
            path.rename(next(place for place in taken if not place.exists()))
        return path


def _mapping(path: Path, parse: Callable[[str], Any]) -> dict[str, Any]:
    """What a file of keys and values says."""
    try:
        found = parse(path.read_text())
    except (yaml.YAMLError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise _damaged(path) from error
    if not isinstance(found, dict):
        raise _damaged(path)
    return found


def _damaged(path: Path) -> ValueError:
    return ValueError(
        f"{path} is damaged: cut off, or something else; put it back, or begin the run again"
        " with overwrite=true"
    )


def _header(path: Path) -> list[str]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return next(csv.reader(file), [])


def _cell(value: Any) -> Any:
    """Numbers with nine digits, which bring a float32 back to the bit."""
    if isinstance(value, float):
        return "" if value != value else format(value, ".9g")
    return "" if value is None else value
