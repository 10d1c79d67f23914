"""The names of a run's folder and files; how a file is written: whole, and tables as CSV."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

CONFIG, MANIFEST, REWARD = "config.yaml", "manifest.json", "reward.txt"
METRICS, EVALUATIONS = "metrics.csv", "evaluations.csv"
CHECKPOINT, EVALUATION, VIDEO = "checkpoint.pt", "evaluation.json", "video.mp4"
POLICY, BEST = "policy.safetensors", "best.safetensors"
POLICIES = {"last": POLICY, "best": BEST}
"""A policy as training left it, and as it was at the best evaluation on the way."""

STRESS, NONE, ALL = "stress.csv", "none", "all"
"""A stress test; in it, the conditions without a disturbance and with every axis at once."""

FURTHER = "evaluations"
"""In a run's folder: evaluations beside its own, each in a folder of its own."""

SWEEPS, OUTCOME = ".sweeps", "outcome.json"
"""Beside the studies: a folder for each sweep, in it one for each of its jobs, with its note."""

PPO, DAGGER, SAC = "ppo", "dagger", "sac"
"""Methods of training, by ``algo.kind``; runs from before there was such a key are PPO's."""

EXPERT = "expert"
"""Imitation's part of a path, where others have their reward's name."""

SIGNALS = "signals"
"""Stands among the cameras of an agent that is told the state."""

_NAME = re.compile(r"\w([\w.+ -]*[\w.+-])?")
_LONGEST_NAME = 100
_LONGEST_LABEL = 90
"""Bytes, at most."""


def seen(cams: Iterable[str], signals: bool = False) -> str:
    """The part of a run's path that names what its agent sees: ``dep_front+seg_side``."""
    return "+".join((*cams, *([SIGNALS] if signals else [])))


def reward_name(reward: Mapping[str, Any]) -> str:
    """The part of a run's path that names its reward: ``reward.name``, or else its kind."""
    return str(reward["kind"] if reward.get("name") is None else reward["name"])


def taught_by(values: Mapping[str, Any]) -> str:
    """The part of a run's path that names its teacher: the reward, or ``expert`` in imitation."""
    return EXPERT if values["algo"].get("kind") == DAGGER else reward_name(values["reward"])


def labelled(taught: str, label: str | None) -> str:
    """The part of a run's path that names its teacher, and its label if it has one."""
    return taught if label is None else f"{taught}+{label}"


def name_of(settings: Iterable[tuple[str, str]]) -> str:
    """A name for a folder from keys and values: ``algo.learning_rate-0.0003+task-wide``.

    A long one is cut, and ends in a sum of all of it.
    """
    text = "+".join(f"{key}-{value}" for key, value in sorted(settings))
    name = re.sub(r"[^\w.+-]+", "_", text).strip("_")
    if len(name.encode()) <= _LONGEST_LABEL:
        return name
    return f"{name[: _LONGEST_LABEL // 3]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def check_name(key: str, name: str) -> None:
    """Raises ``ValueError`` for a name that a shell, Hydra or a file system would not take."""
    if not _NAME.fullmatch(name) or len(name.encode()) > _LONGEST_NAME:
        raise ValueError(
            f"{key}: {name[:40]!r} is no name for a folder; it begins with a letter or digit, and"
            f" has these, . _ + - and blanks within, at most {_LONGEST_NAME}"
        )


def check_folder(key: str, path: str) -> None:
    """Raises ``ValueError`` for a text that is no path: empty, or with a ``~`` of the shell's."""
    if not path.strip() or path.startswith("~"):
        raise ValueError(f"{key}: {path!r} is no path of a folder")


def check_free(out: Path, overwrite: bool, key: str = "out") -> None:
    """Raises ``ValueError`` where something is there that may not be overwritten."""
    if out.exists() and not overwrite:
        raise ValueError(f"{key}: {str(out)!r} exists; choose another or say overwrite=true")


@contextmanager
def new_folder(out: Path, overwrite: bool) -> Iterator[Path]:
    """A folder to write into, which becomes ``out`` when all went well and else vanishes.

    With ``overwrite`` it replaces what is there, once all is written; without, that is refused.
    """
    check_free(out, overwrite)
    partial = out.with_name(out.name + ".partial")
    # What a killed process left.
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        if out.exists():
            shutil.rmtree(out)
        partial.rename(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Replace a file in one step, once all of it is on the disk; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def set_aside(path: Path) -> Path | None:
    """Move what is there, if anything, from ``name.ext`` to ``name.1.ext``; where it is now."""
    if not path.exists():
        return None
    taken = (path.with_stem(f"{path.stem}.{number}") for number in count(1))
    return path.rename(next(place for place in taken if not place.exists()))


def csv_text(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table as CSV, a line feed after each line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
