"""A study's runs, read from their folders; what can't be read is named, never guessed."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from needlehoop.runs import files
from needlehoop.runs.reading import (
    UnreadableError,
    check_within,
    printable,
    read_json,
    read_text,
    read_yaml,
)
from needlehoop.study.data.media import check_film
from needlehoop.study.data.rows import Rows, read_rows

_KEYED = ("update", "step", "wall_time")
_LARGEST = float(2**53)
"""Whole numbers beyond it are none any more, as numbers of a table."""

_OUTCOME = {
    "episodes": (1.0, _LARGEST),
    "success": (0.0, 1.0),
    "cheat": (0.0, 1.0),
    "touched": (0.0, 1.0),
    "return": (-1e9, 1e9),
}
"""What an evaluation says, and between what."""

HUMAN_RETURN = "return_human"
"""The column of an evaluation that has the human reward's points; older ones have none."""

HUMAN_UNIT, FORMER_UNIT = "human_unit", 0.05
"""What says in which scene unit, m, those are; and what it was before evaluations said so."""

_SINCE = {
    HUMAN_RETURN: _OUTCOME["return"],
    HUMAN_UNIT: (0.0, 1e9),
    "grasped": (0.0, 1.0),
    "lifted": (0.0, 1.0),
}
"""What evaluations say besides, if they are not too old."""

_RUN_FILES = re.compile(
    r"(config\.yaml|manifest\.json|reward\.txt|checkpoint\.pt|(metrics|evaluations)(\.\d+)?\.csv"
    r"|policy\.safetensors|evaluation(\.\d+)?\.json|video(\.\d+)?\.mp4)"
)
_RUN_FOLDER = re.compile(r"seed\d+")
_FORMER_RUN = re.compile(r"seed\d+\.\d+")
"""One that another took the place of."""

_STUDY_FILES = {"report.html", "contact_sheet.png", "README.md"}


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
    metrics: Rows | None
    """A row per buffer; columns as in docs/first-run.md."""
    evaluations: Rows | None
    """A row per evaluation on the way."""
    evaluation: Mapping[str, Any] | None
    """The long one at the end."""
    video: Path | None
    """Its film."""

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
    def core_minutes(self) -> float | None:
        """Wall time of its cores, whatever else they did; ``None`` if it is not on record."""
        engine, wall = self.config.get("engine"), self.manifest.get("wall_time")
        threads = (engine.get("threads") if isinstance(engine, Mapping) else None) or (
            self.manifest.get("cpus")
        )
        return core_minutes(wall, threads)

    @property
    def command(self) -> str | None:
        """What makes this run alone, if the manifest knows."""
        words = self.manifest.get("command")
        if not isinstance(words, list):
            return None
        script = ["python"] if words[:1] == ["train.py"] else []
        return " ".join(map(_quoted, [*script, *words]))


@dataclass(frozen=True)
class Study:
    """All runs of a study that can be read, in the order of their places."""

    folder: Path
    runs: tuple[Record, ...]
    left_out: tuple[LeftOut, ...]


@dataclass
class _Reading:
    """What has been found so far."""

    root: Path
    runs: dict[Place, Record] = field(default_factory=dict)
    left_out: list[LeftOut] = field(default_factory=list)

    def leave(self, path: Path, reason: str) -> None:
        self.left_out.append(LeftOut(path.relative_to(self.root), reason))


def read_study(folder: Path) -> Study:
    """Every ``seed<k>`` folder under a study's folder.

    Raises:
        ValueError: no such folder.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; give a study's, such as results/main")
    reading = _Reading(folder)
    loose = {folder: set(_visible(folder)) - _STUDY_FILES}
    for here, folders, names in os.walk(folder):
        place = Path(here)
        if _RUN_FOLDER.fullmatch(place.name):
            folders.clear()
            _read_run(place, reading)
            above = [parent for parent in place.parents if folder in parent.parents]
            loose |= {parent: set(_visible(parent)) for parent in above}
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
    for parent, names in loose.items():
        for name in names:
            reading.leave(parent / name, "is no run")
    runs = tuple(reading.runs[place] for place in sorted(reading.runs))
    return Study(folder, runs, tuple(sorted(reading.left_out, key=str)))


def core_minutes(wall_time: Any, cores: Any) -> float | None:
    """Seconds on so many cores, in core-minutes; ``None`` where one of them is not known."""
    if not (_between(wall_time, 0.0, 1e9) and _between(cores, 1, 1e6)):
        return None
    return float(wall_time) * float(cores) / 60.0


def _visible(folder: Path) -> list[str]:
    """Names of the files in a folder, without hidden ones."""
    return [path.name for path in folder.iterdir() if not path.is_dir() and path.name[0] != "."]


def _read_run(folder: Path, reading: _Reading) -> None:
    for path in sorted(folder.iterdir()):
        if path.name.endswith(".partial"):
            reading.leave(path, "half-written")
        elif not path.is_dir() and not _RUN_FILES.fullmatch(path.name):
            reading.leave(path, "is no file of a run")
    try:
        config = _config(folder / files.CONFIG, reading.root)
    except UnreadableError as error:
        reading.leave(folder, f"no run: its {files.CONFIG} {error}")
        return
    cameras = files.seen(config["cams"], bool(config["obs"].get("signals")))
    place = Place(cameras, folder.parent.name, config["seed"])
    if folder.name != f"seed{place.seed}":
        reading.leave(folder, f"its config has seed {place.seed}")
        return
    if place in reading.runs:
        reading.leave(folder, f"is {place}, as is {reading.runs[place].folder}")
        return
    _check_text(folder / files.REWARD, reading)
    reading.runs[place] = Record(
        place,
        folder,
        config,
        _json(folder / files.MANIFEST, {}, reading) or {},
        _rows(folder / files.METRICS, ("return", "success"), {}, reading),
        _rows(folder / files.EVALUATIONS, _OUTCOME, _OUTCOME, reading),
        _json(folder / files.EVALUATION, _OUTCOME, reading),
        _film(folder / files.VIDEO, reading),
    )


def _config(path: Path, root: Path) -> dict[str, Any]:
    """A run's config, as far as the study needs it checked."""
    if not path.exists():
        raise UnreadableError("is missing")
    config = read_yaml(path, root)
    # Runs of one camera once kept it as a word.
    if isinstance(config.get("cams"), str):
        config["cams"] = files.listed(config["cams"])
    for key, kind in (("cams", list), ("obs", dict), ("algo", dict)):
        if not isinstance(config.get(key), kind):
            raise UnreadableError(f"has no usable {key}")
    if not all(isinstance(camera, str) for camera in config["cams"]):
        raise UnreadableError("has no usable cams")
    counts: dict[str, Any] = {key: config.get(key) for key in ("seed", "steps", "num_envs")}
    counts["algo.horizon"] = config["algo"].get("horizon")
    # Runs older than it have none.
    counts["algo.buffer"] = config["algo"].get("buffer") or 1
    for key, value in counts.items():
        if type(value) is not int or not 0 <= value < 2**64:
            raise UnreadableError(f"has no usable {key}")
    sizes = [counts[key] for key in ("num_envs", "steps", "algo.horizon", "algo.buffer")]
    if min(sizes) < 1 or max(sizes) > _LARGEST:
        raise UnreadableError("has no steps")
    return config


def _json(
    path: Path, numbers: Mapping[str, tuple[float, float]], reading: _Reading
) -> dict[str, Any] | None:
    """A JSON object with ``numbers`` in it; ``None`` and a note where it is something else."""
    if not os.path.lexists(path):
        if path.name == files.MANIFEST:
            reading.leave(path, "is missing")
        return None
    try:
        found = read_json(path, within=reading.root)
    except UnreadableError as error:
        reading.leave(path, str(error))
        return None
    since = {name: _SINCE[name] for name in _SINCE if name in found and numbers}
    limits = {**numbers, **since}
    odd = [key for key, (low, high) in limits.items() if not _between(found.get(key), low, high)]
    if numbers and not _between(found.get("steps_trained") or 0, 0, _LARGEST):
        odd.append("steps_trained")
    if odd:
        reading.leave(path, f"has no usable {', '.join(odd)}")
        return None
    return found


def _rows(
    path: Path,
    columns: Iterable[str],
    numbers: Mapping[str, tuple[float, float]],
    reading: _Reading,
) -> Rows | None:
    """A table with ``columns``, in which updates and steps rise and ``numbers`` are in range."""
    if not os.path.lexists(path):
        return None
    try:
        rows, problems = read_rows(path, (*_KEYED, *numbers), reading.root)
        for name in columns:
            if name not in rows.columns:
                raise UnreadableError(f"is no table of a run: it has no column {name}")
        _check_rising(rows)
        for name, (low, high) in numbers.items():
            if not ((rows[name] >= low) & (rows[name] <= high)).all():
                raise UnreadableError(f"has {name} that are not between {low:g} and {high:g}")
    except UnreadableError as error:
        reading.leave(path, str(error))
        return None
    for problem in problems:
        reading.leave(path, problem)
    return rows


def _check_rising(rows: Rows) -> None:
    """Two processes that write one table leave rows twice, or out of order."""
    for name in ("update", "step"):
        values = rows[name]
        if values[0] < 0 or values[-1] > _LARGEST:
            raise UnreadableError(f"has {name}s that are none")
        falls = np.flatnonzero(np.diff(values) <= 0)
        if len(falls):
            raise UnreadableError(
                f"has {name}s that do not rise, {len(falls)} times, first from {values[falls[0]]:g}"
                f" to {values[falls[0] + 1]:g}: more than one process wrote it"
            )


def _check_text(path: Path, reading: _Reading) -> None:
    try:
        if os.path.lexists(path):
            read_text(path, within=reading.root)
    except UnreadableError as error:
        reading.leave(path, str(error))


def _film(path: Path, reading: _Reading) -> Path | None:
    if not os.path.lexists(path):
        return None
    try:
        check_within(path, reading.root)
        check_film(path)
    except UnreadableError as error:
        reading.leave(path, str(error))
        return None
    return path


def _between(value: Any, low: float, high: float) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and low <= value <= high


def _quoted(word: Any) -> str:
    """A word of a command as a shell takes it, readable where it needs no quotes."""
    text = str(word)
    return text if re.fullmatch(r"[\w@%+=:,./-]+", text) else "'" + text.replace("'", "'\\''") + "'"
