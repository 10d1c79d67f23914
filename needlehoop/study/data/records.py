"""A study's runs, read from their folders; what cannot be read is named, never guessed."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, StringConstraints

from needlehoop.runs import files
from needlehoop.runs.reading import (
    UnreadableError,
    printable,
    read_json,
    read_text,
    read_yaml,
)
from needlehoop.study.data.contents import (
    RETURN_RANGE,
    UNKNOWN,
    Rows,
    Stressed,
    TaskNote,
    check_film,
    checked,
    read_rows,
    read_stress,
    task_of,
)

_LARGEST = float(2**53)
"""Whole numbers beyond it are none any more, as numbers of a table."""

HUMAN_RETURN, HUMAN_UNIT = "return_human", "human_unit"
"""What an evaluation says of the human reward: its points, and its scene unit in m."""

_MORE = {"steps_trained": (0.0, _LARGEST), HUMAN_RETURN: RETURN_RANGE, HUMAN_UNIT: (0.0, 1e9)}
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
    """Its film."""
    stress: tuple[Stressed, ...] = ()
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
        """Its settings as they are typed on the command line, by names such as ``algo.gamma``."""
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


@dataclass
class _Reading:
    """What has been found so far."""

    root: Path
    runs: dict[Place, Record] = field(default_factory=dict)
    left_out: list[LeftOut] = field(default_factory=list)

    def leave(self, path: Path, reason: str) -> None:
        self.left_out.append(LeftOut(path.relative_to(self.root), reason))

    def read(self, path: Path, of: Callable[[Path], Any]) -> Any:
        """What a file holds; ``None`` where there is none, or where it is left out."""
        if not os.path.lexists(path):
            return None
        try:
            return of(path)
        except UnreadableError as error:
            self.leave(path, str(error))
            return None

    def rows(self, path: Path, ranges: Mapping[str, tuple[float, float]]) -> Rows:
        rows, problems = read_rows(path, ranges, self.root)
        for problem in problems:
            self.leave(path, problem)
        return rows


def read_study(folder: Path) -> Study:
    """Every ``seed<k>`` folder under a study's folder.

    Raises:
        ValueError: no such folder.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; give a study's, such as results/main")
    reading = _Reading(folder)
    for here, folders, names in os.walk(folder):
        place = Path(here)
        if _RUN_FOLDER.fullmatch(place.name):
            folders.clear()
            _read_run(place, reading)
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
    runs = tuple(reading.runs[place] for place in sorted(reading.runs))
    return Study(folder, runs, tuple(sorted(reading.left_out, key=str)))


def read_run(folder: Path) -> tuple[Record, tuple[LeftOut, ...]]:
    """One run, whatever its folder is called, and what of it was left out.

    Raises:
        ValueError: no run that can be read.
    """
    reading = _Reading(folder)
    try:
        config = _config(folder / files.CONFIG, folder)
    except UnreadableError as error:
        raise ValueError(f"{folder} is no run: its {files.CONFIG} {error}") from error
    return _record(folder, config, reading), tuple(reading.left_out)


def _read_run(folder: Path, reading: _Reading) -> None:
    try:
        config = _config(folder / files.CONFIG, reading.root)
    except UnreadableError as error:
        reading.leave(folder, f"no run: its {files.CONFIG} {error}")
        return
    place = _place(folder, config)
    if folder.name != f"seed{place.seed}":
        reading.leave(folder, f"its config has seed {place.seed}")
    elif place in reading.runs:
        reading.leave(folder, f"is {place}, as is {reading.runs[place].folder}")
    else:
        reading.runs[place] = _record(folder, config, reading)


def _place(folder: Path, config: Mapping[str, Any]) -> Place:
    cameras = files.seen(config["cams"], bool(config["obs"].get("signals")))
    return Place(cameras, folder.parent.name, config["seed"])


def _record(folder: Path, config: Mapping[str, Any], reading: _Reading) -> Record:
    """A run whose config can be read."""
    root = reading.root
    if not os.path.lexists(folder / files.MANIFEST):
        reading.leave(folder / files.MANIFEST, "is missing")
    manifest = reading.read(folder / files.MANIFEST, lambda path: read_json(path, within=root))
    task = UNKNOWN
    if manifest is not None:
        task = reading.read(folder / files.MANIFEST, lambda _: task_of(manifest)) or UNKNOWN
    outcome = _outcome(task)
    reading.read(folder / files.REWARD, lambda path: read_text(path, within=root))
    return Record(
        _place(folder, config),
        folder,
        config,
        manifest or {},
        task,
        reading.read(folder / files.METRICS, lambda path: reading.rows(path, {})),
        reading.read(folder / files.EVALUATIONS, lambda path: reading.rows(path, outcome)),
        reading.read(folder / files.EVALUATION, lambda path: _evaluation(path, outcome, root)),
        reading.read(folder / files.VIDEO, lambda path: check_film(path, root)),
        reading.read(folder / files.STRESS, lambda path: read_stress(path, root)) or (),
    )


def _config(path: Path, root: Path) -> dict[str, Any]:
    """A run's config; what the study uses of it is checked."""
    if not path.exists():
        raise UnreadableError("is missing")
    config = read_yaml(path, root)
    checked(_Config, config)
    return config


def _outcome(task: TaskNote) -> dict[str, tuple[float, float]]:
    """What an evaluation says, and the range of each number."""
    shares = dict.fromkeys(task.columns, (0.0, 1.0))
    return {"episodes": (1.0, _LARGEST), **shares, "return": RETURN_RANGE}


def _evaluation(
    path: Path, outcome: Mapping[str, tuple[float, float]], root: Path
) -> dict[str, Any]:
    """The long evaluation at the end of a run."""
    found = read_json(path, within=root)
    # Not every task's human reward has a unit.
    limits = {**outcome, **{key: _MORE[key] for key in _MORE if found.get(key) is not None}}
    odd = [key for key, ends in limits.items() if not _between(found.get(key), *ends)]
    if odd:
        raise UnreadableError(f"has no usable {', '.join(odd)}")
    return found


def _between(value: Any, low: float, high: float) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and low <= value <= high


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
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list):
        return f"[{','.join(map(_typed, value))}]"
    return str(value)
