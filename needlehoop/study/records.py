"""A study's runs, read from their folders; what can't be read is named, never guessed."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from needlehoop.runs import files
from needlehoop.study.media import check_film
from needlehoop.study.rows import Rows, UnreadableError, read_keys, read_rows, read_text

_KEYED = ("update", "step", "wall_time")
_OUTCOME = ("episodes", "success", "cheat", "touched", "return")
# libyaml's is ten times as fast, where it was built in.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_RUN_FILES = re.compile(
    r"(config\.yaml|manifest\.json|reward\.txt|metrics\.csv|evaluations\.csv|checkpoint\.pt"
    r"|policy\.safetensors|evaluation(\.\d+)?\.json|video(\.\d+)?\.mp4)"
)
_RUN_FOLDER = re.compile(r"seed\d+")
_STUDY_FILES = {"report.html", "contact_sheet.png", "README.md"}


@dataclass(frozen=True)
class LeftOut:
    """A file, or a part of one, that the study does not count."""

    path: Path
    """From the study's folder."""
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


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
    """A row per buffer; columns as in the README."""
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
        buffer = self.config["num_envs"] * self.config["algo"]["horizon"]
        return self.config["steps"] // buffer * buffer

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return 0 if self.metrics is None else int(self.metrics["step"][-1])

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
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if place != folder and files.CONFIG in names:
            reading.leave(place, "holds a run but is not called seed<k>")
            folders.clear()
    for parent, names in loose.items():
        for name in names:
            reading.leave(parent / name, "is no run")
    runs = tuple(reading.runs[place] for place in sorted(reading.runs))
    return Study(folder, runs, tuple(sorted(reading.left_out, key=str)))


def _visible(folder: Path) -> list[str]:
    """Names of the files in a folder, without hidden ones."""
    return [path.name for path in folder.iterdir() if path.is_file() and path.name[0] != "."]


def _read_run(folder: Path, reading: _Reading) -> None:
    for path in sorted(folder.iterdir()):
        if path.name.endswith(".partial"):
            reading.leave(path, "half-written")
        elif not path.is_dir() and not _RUN_FILES.fullmatch(path.name):
            reading.leave(path, "is no file of a run")
    try:
        config = _config(folder / files.CONFIG)
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
        _json(folder / files.MANIFEST, (), reading) or {},
        _rows(folder / files.METRICS, (*_KEYED, "return", "success"), _KEYED, reading),
        _rows(folder / files.EVALUATIONS, (*_KEYED, *_OUTCOME), (*_KEYED, *_OUTCOME), reading),
        _json(folder / files.EVALUATION, _OUTCOME, reading),
        _film(folder / files.VIDEO, reading),
    )


def _config(path: Path) -> dict[str, Any]:
    """A run's config, as far as the study needs it checked."""
    if not path.exists():
        raise UnreadableError("is missing")
    try:
        config = yaml.load(read_text(path), _LOADER)
    except yaml.YAMLError as error:
        raise UnreadableError("is no YAML") from error
    if not isinstance(config, dict):
        raise UnreadableError("holds no keys")
    # Runs of one camera once kept it as a word.
    if isinstance(config.get("cams"), str):
        config["cams"] = files.listed(config["cams"])
    kinds = {"cams": list, "obs": dict, "algo": dict, "seed": int, "steps": int, "num_envs": int}
    for key, kind in kinds.items():
        if not isinstance(config.get(key), kind):
            raise UnreadableError(f"has no usable {key}")
    if not all(isinstance(camera, str) for camera in config["cams"]):
        raise UnreadableError("has no usable cams")
    if not isinstance(config["algo"].get("horizon"), int):
        raise UnreadableError("has no usable algo.horizon")
    if min(config["num_envs"], config["algo"]["horizon"], config["steps"]) < 1:
        raise UnreadableError("has no steps")
    return config


def _json(path: Path, numbers: tuple[str, ...], reading: _Reading) -> dict[str, Any] | None:
    """A JSON object with ``numbers`` in it; ``None`` and a note where it is something else."""
    if not path.exists():
        if path.name == files.MANIFEST:
            reading.leave(path, "is missing")
        return None
    try:
        found = read_keys(path)
    except UnreadableError as error:
        reading.leave(path, str(error))
        return None
    odd = [key for key in numbers if not _finite(found.get(key))]
    if odd:
        reading.leave(path, f"has no usable {', '.join(odd)}")
        return None
    return found


def _rows(
    path: Path, columns: tuple[str, ...], filled: tuple[str, ...], reading: _Reading
) -> Rows | None:
    if not path.exists():
        return None
    try:
        rows, problems = read_rows(path, filled)
        for name in columns:
            if name not in rows.columns:
                raise UnreadableError(f"is no table of a run: it has no column {name}")
        if "episodes" in filled and (rows["episodes"] < 1).any():
            raise UnreadableError("has an evaluation of no episodes")
    except UnreadableError as error:
        reading.leave(path, str(error))
        return None
    for problem in problems:
        reading.leave(path, problem)
    return rows


def _check_text(path: Path, reading: _Reading) -> None:
    try:
        if path.exists():
            read_text(path)
    except UnreadableError as error:
        reading.leave(path, str(error))


def _film(path: Path, reading: _Reading) -> Path | None:
    if not path.is_file():
        return None
    try:
        check_film(path)
    except UnreadableError as error:
        reading.leave(path, str(error))
        return None
    return path


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _quoted(word: Any) -> str:
    """A word of a command as a shell takes it, readable where it needs no quotes."""
    text = str(word)
    return text if re.fullmatch(r"[\w@%+=:,./-]+", text) else "'" + text.replace("'", "'\\''") + "'"
