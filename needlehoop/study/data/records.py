"""A study's runs, read from their folders. A run that cannot be read is named and left out."""

from __future__ import annotations

import io
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter

from needlehoop.runs import files
from needlehoop.runs.reading import read_json, read_yaml


@dataclass(frozen=True)
class TaskNote:
    """What the study needs of a task; a run writes it down when it is created."""

    name: str
    goal: str
    """The fact that says that the task is done."""
    columns: tuple[str, ...]
    """Names in ``metrics.csv`` and evaluations of what was true at an episode's end."""
    phases: tuple[tuple[str, str], ...]
    """Parts of the task in their order: name, and the fact that ends it."""


@dataclass(frozen=True, order=True)
class Place:
    """What identifies a run: its cameras, its reward and its seed."""

    cameras: str
    """Joined by ``+``, as in the folder's name: ``dep_front+seg_side``."""
    reward: str
    """With its label, if it has one: ``human+task-wide``."""
    seed: int

    def __str__(self) -> str:
        return f"{self.cameras}/{self.reward}/seed{self.seed}"


@dataclass(frozen=True)
class Record:
    """What the files of one run say."""

    place: Place
    folder: Path
    config: Mapping[str, Any]
    manifest: Mapping[str, Any]
    task: TaskNote
    metrics: pd.DataFrame | None
    """A row per buffer; columns as in docs/first-run.md; NaN where no episode ended."""
    evaluations: pd.DataFrame | None
    """A row per evaluation on the way."""
    evaluation: Mapping[str, Any] | None
    """The long one at the end."""
    video: Path | None
    stress: pd.DataFrame | None
    """A row per condition: ``axis``, ``severity``, ``episodes``, ``success`` and more."""

    @property
    def finished(self) -> bool:
        return self.manifest.get("finished") is True

    @property
    def planned_steps(self) -> int:
        """Environment steps that the run is to have: the whole buffers in ``steps``."""
        return self.config["steps"] // self.buffer * self.buffer

    @property
    def buffer(self) -> int:
        """Environment steps per buffer."""
        algo = self.config["algo"]
        return algo.get("buffer") or self.config["num_envs"] * algo["horizon"]

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return 0 if self.metrics is None else int(max(self.metrics["step"]))

    @property
    def command(self) -> str:
        """What makes this run alone."""
        words = self.manifest["command"]
        return shlex.join(["python", *words] if words[0] == "train.py" else words)


@dataclass(frozen=True)
class Study:
    """All runs of a study that can be read, in the order of their places."""

    folder: Path
    runs: tuple[Record, ...]
    left_out: tuple[str, ...]
    """Folders that do not count, each with the reason."""

    def is_of(self, task: str) -> bool:
        """Whether all its runs are of this task."""
        return {run.task.name for run in self.runs} == {task}


def read_study(folder: Path) -> Study:
    """Every ``<cameras>/<reward>/seed<k>`` in a study's folder; ``ValueError`` without one."""
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder")
    runs: dict[Place, Record] = {}
    left_out = []
    # A name such as seed0.1 is of a run that was set aside.
    paths = [path for path in folder.glob("*/*/seed*") if re.fullmatch(r"seed\d+", path.name)]
    for path in sorted(paths):
        try:
            run = _record(path)
            if run.place in runs:
                raise ValueError(f"is {run.place}, as is {runs[run.place].folder}")
            runs[run.place] = run
        except ValueError as error:
            left_out.append(f"{path.relative_to(folder)}: {error}")
    return Study(folder, tuple(runs[place] for place in sorted(runs)), tuple(left_out))


def read_run(folder: Path) -> Study:
    """One run alone, whatever its folder is called; ``ValueError`` if it can't be read."""
    try:
        return Study(folder, (_record(folder),), ())
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error


def _record(folder: Path) -> Record:
    """The run in a folder. Raises ``ValueError`` with the name of a file that is damaged."""

    def read(name: str, of: Callable[[Path], Any]) -> Any:
        path = folder / name
        if not path.exists() and name not in (files.CONFIG, files.MANIFEST):
            return None
        try:
            return of(path)
        except (OSError, ValueError) as error:
            reason = str(error).removeprefix(str(path))
            raise ValueError(f"{name}: {' '.join(reason.split())}") from error

    config, manifest = read(files.CONFIG, read_yaml), read(files.MANIFEST, read_json)
    keys = ("cams", "obs", "algo", "seed", "steps", "num_envs")
    if missing := [key for key in keys if key not in config]:
        raise ValueError(f"{files.CONFIG}: has no {', '.join(missing)}")
    cameras = files.seen(config["cams"], bool(config["obs"].get("signals")))
    return Record(
        Place(cameras, folder.parent.name, config["seed"]),
        folder,
        config,
        manifest,
        TypeAdapter(TaskNote).validate_python(manifest.get("task")),
        read(files.METRICS, _rows),
        read(files.EVALUATIONS, _rows),
        read(files.EVALUATION, read_json),
        read(files.VIDEO, Path),
        read(files.STRESS, pd.read_csv),
    )


def _rows(path: Path) -> pd.DataFrame | None:
    """A run's table; ``None`` before its first row, ``ValueError`` if its steps don't rise."""
    # A row without a line's end was cut off by a kill, even if it looks whole.
    whole, _, _ = path.read_text(encoding="utf-8").rpartition("\n")
    rows = pd.read_csv(io.StringIO(whole), dtype=float)
    if "step" not in rows or (np.diff(rows["step"]) <= 0).any():
        raise ValueError("has no steps that rise: it is none, or several processes wrote it")
    return None if rows.empty else rows
