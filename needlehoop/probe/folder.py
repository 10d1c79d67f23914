"""A probe's folder: settings, manifest, and a file of errors for each seed and camera set."""

from __future__ import annotations

import csv
import io
import json
import re
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from needlehoop.probe.frames import KINDS
from needlehoop.probe.plan import CONSTANT, TRUTH
from needlehoop.probe.quantities import Quantities
from needlehoop.probe.scores import Errors, Interval, error, places, score
from needlehoop.runs.files import CONFIG, MANIFEST, csv_text, set_aside, write_whole
from needlehoop.runs.machine import peak_memory, provenance
from needlehoop.runs.reading import TABLE, UnreadableError, read_json, read_text, read_yaml

_ANY = ("cams", "seeds", "results", "study", "overwrite", "device", "engine")
"""Settings that may change from one call to the next. The results only grow."""

_SEED = re.compile(r"seed\d+")


class Folder:
    """A probe's folder. What it already holds is not measured again.

    Args:
        path: made where missing.
        asked: what is measured.
        config: the composed settings, as plain values.
        overwrite: whether errors that are there are set aside, under a number.
        command: the words it was called with, for the manifest.

    Raises:
        ValueError: the folder holds something else, or a probe with other settings.
    """

    def __init__(
        self,
        path: Path,
        asked: Quantities,
        config: Mapping[str, Any],
        overwrite: bool,
        command: Sequence[str] = (),
    ):
        self.path, self.asked = path, asked
        self._columns = _columns(asked)
        self._began, self._lock = time.perf_counter(), threading.Lock()
        self._origin = {**provenance(), "command": list(command)}
        own, held = dict(config), path / CONFIG
        before: dict[str, Any] = {}
        if path.exists() and any(file.is_file() for file in path.iterdir()):
            try:
                before = read_yaml(held) if held.is_file() else {}
            except UnreadableError as error:
                raise ValueError(f"{held} {error}; choose another study=") from error
            if "fit" not in before:
                raise ValueError(f"{path} holds files but no probe; choose another study=")
            other = sorted(
                key for key in {*own, *before} - {*_ANY} if before.get(key) != own.get(key)
            )
            if other and not overwrite:
                raise ValueError(
                    f"{path} holds a probe with another {', '.join(other)}; choose another study="
                    " or replace it with overwrite=true"
                )
            if overwrite:
                for old in path.glob("seed*"):
                    if _SEED.fullmatch(old.name):
                        set_aside(old)
                (path / MANIFEST).unlink(missing_ok=True)
        self._before = _manifest(path / MANIFEST)
        path.mkdir(parents=True, exist_ok=True)
        # A call that only shows results changes nothing.
        if overwrite or any(before.get(key) != own.get(key) for key in ("fit", "cams", "seeds")):
            write_whole(held, yaml.safe_dump(own, sort_keys=False))

    def has(self, seed: int, name: str) -> bool:
        """Whether a camera set's errors are there."""
        return errors_of(self.path, seed, name).exists()

    def names(self, seeds: int) -> list[str]:
        """Camera sets whose errors are there for every seed below ``seeds``."""
        found = [
            {file.stem for file in (self.path / f"seed{s}").glob("*.csv")} for s in range(seeds)
        ]
        return sorted(set.intersection(*found))

    def save(self, seed: int, name: str, found: Errors) -> None:
        """Write a camera set's errors, whole or not at all, and what it took."""
        rows = []
        for episode, (mean, frames) in enumerate(zip(found.mean, found.frames, strict=True)):
            cells = ["" if np.isnan(value) else f"{value:.4g}" for value in mean.flatten()]
            rows.append((episode, KINDS[episode % len(KINDS)], *frames, *cells))
        path = errors_of(self.path, seed, name)
        path.parent.mkdir(exist_ok=True)
        write_whole(path, csv_text(self._columns, rows))
        self._note()

    def load(self, seed: int, name: str) -> Errors:
        """A camera set's errors.

        Raises:
            ValueError: the file is not one that ``save`` wrote.
        """
        path = errors_of(self.path, seed, name)
        try:
            header, *rows = csv.reader(io.StringIO(read_text(path, TABLE)))
        except (UnreadableError, csv.Error) as error:
            raise ValueError(f"{path} {error}; delete it to have it made again") from error
        if header != self._columns or any(len(row) != len(header) for row in rows):
            raise ValueError(f"{path} is not a probe's; delete it to have it made again")
        phases, names = len(self.asked.phases), len(self.asked.names)
        first = 2 + phases
        values = [[float(cell) if cell else np.nan for cell in row[first:]] for row in rows]
        frames = [[int(cell) for cell in row[2:first]] for row in rows]
        return Errors(np.array(values).reshape(len(rows), phases, names), np.array(frames))

    def _note(self) -> None:
        """Bring the manifest up to date: time and memory of all calls that measured something."""
        with self._lock:
            spent = self._before.get("wall_time", 0.0) + time.perf_counter() - self._began
            memory = max(self._before.get("memory_gb", 0.0), peak_memory())
            facts = {"wall_time": round(spent, 1), "memory_gb": round(memory, 2)}
            text = json.dumps({**self._origin, **facts}, indent=2)
            write_whole(self.path / MANIFEST, text + "\n")


def errors_of(place: Path, seed: int, name: str) -> Path:
    """The file of a camera set's errors in a probe's folder."""
    return place / f"seed{seed}" / f"{name}.csv"


def _columns(asked: Quantities) -> list[str]:
    return [
        "episode",
        "kind",
        *(f"{phase}_frames" for phase in asked.phases),
        *(f"{phase}_{name}" for phase in asked.phases for name in asked.names),
    ]


def _manifest(path: Path) -> dict[str, Any]:
    """What an earlier call noted; empty if there was none."""
    if not path.exists():
        return {}
    try:
        found = read_json(path)
        for key in ("wall_time", "memory_gb"):
            if isinstance(found.get(key, 0.0), bool | str | list | dict | None):
                raise UnreadableError(f"has no usable {key}")
    except UnreadableError as error:
        raise ValueError(f"{path} {error}; delete it, and time is counted anew") from error
    return found


@dataclass(frozen=True)
class ProbeResults:
    """Scores of camera sets and baselines, by name."""

    asked: Quantities
    errors: dict[str, list[Errors]]
    """By seed."""
    scores: dict[str, Interval]
    by_seed: dict[str, list[float]]
    places: dict[str, tuple[int, int]]
    """Of camera sets: the best and the worst place that the intervals leave open."""

    @property
    def ranked(self) -> tuple[str, ...]:
        """Camera sets, the best score first; without the baselines."""
        return tuple(sorted(self.places, key=lambda name: (-self.scores[name].value, name)))

    @property
    def seeds(self) -> int:
        """Probes that each value is a mean of."""
        return len(self.errors[CONSTANT])

    def error(self, name: str, phase: str, quantity: str) -> Interval:
        """Mean error in mm (of the fact: a share) over held-out episodes."""
        return error(self.asked, self.errors[name], phase, quantity)


def read_results(folder: Folder, seeds: int) -> ProbeResults:
    """Everything in a folder that has been probed with every seed.

    Raises:
        ValueError: a file that is not a probe's.
    """
    found = {
        name: [folder.load(seed, name) for seed in range(seeds)] for name in folder.names(seeds)
    }
    asked, blind = folder.asked, found[CONSTANT]
    scores = {name: score(asked, own, blind) for name, own in found.items()}
    by_seed = {
        name: [score(asked, [one], [other]).value for one, other in zip(own, blind, strict=True)]
        for name, own in found.items()
    }
    cameras = {name: value for name, value in scores.items() if name not in (TRUTH, CONSTANT)}
    return ProbeResults(asked, found, scores, by_seed, places(cameras))
