"""A study's runs, read from their folders; what cannot be read is named, never guessed."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, StringConstraints

from needlehoop.runs import files
from needlehoop.runs.reading import UnreadableError, printable, read_json, read_text, read_yaml
from needlehoop.study.data.contents import (
    LARGEST,
    RETURN_RANGE,
    UNKNOWN,
    Ranges,
    Rows,
    Stressed,
    TaskNote,
    check_media,
    checked,
    read_entries,
    read_rows,
    task_of,
)

HUMAN_RETURN = "return_human"
"""The points that the human reward gives an evaluation's episodes."""

_MORE = {"steps_trained": (0.0, LARGEST), HUMAN_RETURN: RETURN_RANGE}
"""What ``evaluation.json`` may say besides, and the range of each number."""

_RUN_FOLDER = re.compile(r"seed\d+")
_FORMER_RUN = re.compile(r"seed\d+\.\d+")
"""A run that was set aside for another."""

_Camera = Annotated[str, StringConstraints(pattern=r"^\w[\w.-]{0,39}$")]
"""A camera's name: figures and tables have room for it."""

_Size = Annotated[int, Field(ge=1, le=2**53)]


class _Algo(BaseModel, strict=True):
    horizon: _Size
    buffer: Annotated[int, Field(ge=0, le=2**53)] | None = None
    """Imitation has none of its own."""


class _Config(BaseModel, strict=True):
    """What the study uses of a run's config."""

    cams: list[_Camera]
    obs: dict
    algo: _Algo
    seed: Annotated[int, Field(ge=0, lt=2**64)]
    steps: _Size
    num_envs: _Size


@dataclass(frozen=True)
class LeftOut:
    """A file, or a part of one, that the study does not count."""

    path: Path
    """From the study's folder."""
    reason: str

    def __str__(self) -> str:
        return printable(f"{self.path}: {self.reason}")


@dataclass(frozen=True, order=True)
class Place:
    """Which run it is: what it saw, what it was paid for, what it was seeded with."""

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
    """Empty where it can't be read."""
    task: TaskNote
    metrics: Rows | None
    """A row per buffer; columns as in docs/first-run.md."""
    evaluations: Rows | None
    """A row per evaluation on the way."""
    evaluation: Mapping[str, Any] | None
    """The long one at the end."""
    video: Path | None
    stress: tuple[Stressed, ...]
    """What disturbances cost it; empty where nobody tried."""

    @property
    def finished(self) -> bool:
        """Whether training, evaluation and film are done."""
        return self.manifest.get("finished") is True

    @property
    def stopped(self) -> bool:
        """Whether somebody stopped it in an orderly way, when it last wrote its manifest."""
        return self.manifest.get("stopped") is True

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
        return 0 if self.metrics is None else int(self.metrics["step"][-1])

    @property
    def settings(self) -> dict[str, str]:
        return typed_settings(self.config)

    @property
    def command(self) -> str | None:
        """What makes this run alone, if the manifest knows."""
        words = self.manifest.get("command")
        if not isinstance(words, list):
            return None
        script = ["python"] if words[:1] == ["train.py"] else []
        return shlex.join(map(str, [*script, *words]))


@dataclass(frozen=True)
class Study:
    """All runs of a study that can be read, in the order of their places."""

    folder: Path
    runs: tuple[Record, ...]
    left_out: tuple[LeftOut, ...]

    def is_of(self, task: str) -> bool:
        """Whether its runs say that they are of this task, and none that it is of another."""
        return {run.task.name for run in self.runs} - {UNKNOWN.name} == {task}


class _Reading:
    """Reads runs below a folder, and notes what is left out of them."""

    def __init__(self, root: Path):
        self.root = root
        self.left_out: list[LeftOut] = []

    def leave(self, path: Path, reason: str) -> None:
        self.left_out.append(LeftOut(path.relative_to(self.root), reason))

    def read(self, path: Path, of: Callable[[Path], Any]) -> Any:
        """What a file or folder holds; ``None`` where there is none, or where it is left out."""
        if not os.path.lexists(path):
            return None
        try:
            return of(path)
        except UnreadableError as error:
            self.leave(path, str(error))
            return None

    def rows(self, path: Path, ranges: Ranges) -> Rows:
        rows, torn = read_rows(path, ranges, self.root)
        if torn:
            self.leave(path, "last row left out: torn off")
        return rows

    def run(self, folder: Path, others: Mapping[Place, Record] | None = None) -> Record:
        """The run in a folder, whose files but for the config may be left out.

        Args:
            folder: of the run; among ``others`` it must be called after the run's seed.
            others: a study's runs so far.

        Raises:
            UnreadableError: no config that can be read, or it is another run's.
        """
        root = self.root
        place, config = self._place(folder)
        if others is not None and folder.name != f"seed{place.seed}":
            raise UnreadableError(f"its config has seed {place.seed}")
        if others and place in others:
            raise UnreadableError(f"is {place}, as is {others[place].folder}")
        if not os.path.lexists(folder / files.MANIFEST):
            self.leave(folder / files.MANIFEST, "is missing")
        manifest = self.read(folder / files.MANIFEST, read_json)
        task = UNKNOWN
        if manifest is not None:
            task = self.read(folder / files.MANIFEST, lambda _: task_of(manifest)) or UNKNOWN
        shares = dict.fromkeys(task.columns, (0.0, 1.0))
        outcome = {"episodes": (1.0, LARGEST), **shares, "return": RETURN_RANGE}
        self.read(folder / files.REWARD, read_text)
        return Record(
            place,
            folder,
            config,
            manifest or {},
            task,
            self.read(folder / files.METRICS, lambda path: self.rows(path, {})),
            self.read(folder / files.EVALUATIONS, lambda path: self.rows(path, outcome)),
            self.read(folder / files.EVALUATION, lambda path: _evaluation(path, outcome, root)),
            self.read(folder / files.VIDEO, lambda path: check_media(path, root)),
            self.read(folder / files.STRESS, lambda path: read_entries(path, Stressed, root)) or (),
        )

    def _place(self, folder: Path) -> tuple[Place, dict[str, Any]]:
        """Which run a folder's config says it is, and the config."""
        path = folder / files.CONFIG
        try:
            if not path.exists():
                raise UnreadableError("is missing")
            config = read_yaml(path)
            checked(_Config, config)
        except UnreadableError as error:
            raise UnreadableError(f"no run: its {files.CONFIG} {error}") from error
        cameras = files.seen(config["cams"], bool(config["obs"].get("signals")))
        return Place(cameras, folder.parent.name, config["seed"]), config


def read_study(folder: Path) -> Study:
    """Every ``seed<k>`` folder under a study's folder.

    Raises:
        ValueError: no such folder.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; give a study's, such as results/main")
    reading = _Reading(folder)
    runs: dict[Place, Record] = {}
    for here, folders, names in os.walk(folder):
        place = Path(here)
        if _RUN_FOLDER.fullmatch(place.name):
            folders.clear()
            run = reading.read(place, lambda path: reading.run(path, runs))
            if run is not None:
                runs[run.place] = run
            continue
        # In the order of names, whatever the file system's is.
        folders[:] = sorted(
            name for name in folders if name[0] != "." and not _FORMER_RUN.fullmatch(name)
        )
        for name in folders:
            if (place / name).is_symlink():
                reading.leave(place / name, "is a link to a folder, and not followed")
        if place != folder and files.CONFIG in names:
            reading.leave(place, "holds a run but is not called seed<k>")
            folders.clear()
    left_out = tuple(sorted(reading.left_out, key=str))
    return Study(folder, tuple(runs[place] for place in sorted(runs)), left_out)


def read_run(folder: Path) -> Study:
    """One run alone, whatever its folder is called.

    Raises:
        ValueError: no run that can be read.
    """
    reading = _Reading(folder)
    try:
        return Study(folder, (reading.run(folder),), tuple(reading.left_out))
    except UnreadableError as error:
        raise ValueError(f"{folder}: {error}") from error


def _evaluation(path: Path, outcome: Ranges, root: Path) -> dict[str, Any]:
    """The long evaluation at the end of a run."""
    found = read_json(path)
    limits = {**outcome, **{key: _MORE[key] for key in _MORE if found.get(key) is not None}}
    odd = [key for key, ends in limits.items() if not _between(found.get(key), *ends)]
    if odd:
        raise UnreadableError(f"has no usable {', '.join(odd)}")
    return found


def _between(value: Any, low: float, high: float) -> bool:
    return isinstance(value, int | float) and value is not True and low <= value <= high


def typed_settings(values: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Settings as they are typed on the command line, by names such as ``algo.gamma``."""
    found: dict[str, str] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        inner = isinstance(value, Mapping)
        found |= typed_settings(value, f"{name}.") if inner else {name: _typed(value)}
    return found


def _typed(value: Any) -> str:
    """A value as Hydra takes it."""
    if isinstance(value, list):
        return f"[{','.join(map(_typed, value))}]"
    return json.dumps(value) if value is None or isinstance(value, bool) else str(value)
