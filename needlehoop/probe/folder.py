"""A probe's folder: settings, manifest, and a file of errors for each seed and camera set."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from needlehoop.config.changing import differing
from needlehoop.probe.frames import KINDS, Quantities
from needlehoop.probe.scores import ProbeResults
from needlehoop.runs.files import CONFIG, MANIFEST, csv_text, set_aside, write_whole
from needlehoop.runs.machine import peak_memory, provenance
from needlehoop.runs.reading import UnreadableError, named, read_text, read_yaml
from needlehoop.runs.run import Run

_ANY = ("cams", "seeds", "results", "study", "overwrite", "device")
"""Settings that may change from one call to the next. The results only grow."""


class Folder:
    """A probe's folder. What it already holds is not measured again.

    Args:
        path: made where missing.
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
        self._columns = [
            *("episode", "kind", *(f"{phase}_frames" for phase in asked.phases)),
            *(f"{phase}_{name}" for phase in asked.phases for name in asked.names),
        ]
        self._run = Run(path)
        self._began, self._command = time.perf_counter(), list(command)
        own, held = dict(config), path / CONFIG
        before: dict[str, Any] = {}
        if path.exists() and any(file.is_file() for file in path.iterdir()):
            with named(held, "choose another study="):
                before = read_yaml(held) if held.is_file() else {}
            if "fit" not in before:
                raise ValueError(f"{path} holds files but no probe; choose another study=")
            other = differing(before, own, _ANY)
            if other and not overwrite:
                raise ValueError(
                    f"{path} holds a probe with another {other}; choose another study="
                    " or replace it with overwrite=true"
                )
            if overwrite:
                for old in path.glob("seed*"):
                    if old.name.removeprefix("seed").isdecimal():
                        set_aside(old)
                (path / MANIFEST).unlink(missing_ok=True)
        self._before = self._run.manifest()
        path.mkdir(parents=True, exist_ok=True)
        # A call that only shows results changes nothing.
        if overwrite or any(before.get(key) != own.get(key) for key in ("fit", "cams", "seeds")):
            write_whole(held, yaml.safe_dump(own, sort_keys=False))

    def save(self, seed: int, name: str, means: np.ndarray, frames: np.ndarray) -> None:
        """Write a camera set's errors, whole or not at all; see ``errors``."""
        rows = []
        for episode, (own, seen) in enumerate(zip(means, frames, strict=True)):
            cells = ["" if np.isnan(value) else f"{value:.4g}" for value in own.flatten()]
            rows.append((episode, KINDS[episode % len(KINDS)], *seen, *cells))
        path = errors_of(self.path, seed, name)
        path.parent.mkdir(exist_ok=True)
        write_whole(path, csv_text(self._columns, rows))

    def note(self) -> None:
        """Note in the manifest what all calls took that measured something."""
        spent = self._before.get("wall_time", 0.0) + time.perf_counter() - self._began
        memory = max(self._before.get("memory_gb", 0.0), peak_memory())
        facts = {"wall_time": round(spent, 1), "memory_gb": round(memory, 2)}
        self._run.note(**provenance(), command=self._command, **facts)

    def load(self, seed: int, name: str) -> np.ndarray:
        """A camera set's mean errors ``(episodes, phases, quantities)``.

        Raises:
            ValueError: the file is not one that ``save`` wrote.
        """
        path, asked = errors_of(self.path, seed, name), self.asked
        with named(path, "delete it to have it made again"):
            header, *rows = read_text(path).splitlines()
            if header != ",".join(self._columns) or any(
                row.count(",") != header.count(",") for row in rows
            ):
                raise UnreadableError("is not a probe's")
        # What is no number, such as an empty cell, becomes NaN.
        cells = np.genfromtxt(rows, delimiter=",", ndmin=2)[:, 2 + len(asked.phases) :]
        return cells.reshape(len(rows), len(asked.phases), len(asked.names))

    def results(self, seeds: int) -> ProbeResults:
        """All that was probed with every seed; errors as in ``load``."""
        files = ({f.stem for f in (self.path / f"seed{s}").glob("*.csv")} for s in range(seeds))
        means = {
            name: np.stack([self.load(seed, name) for seed in range(seeds)])
            for name in sorted(set.intersection(*files))
        }
        return ProbeResults(self.asked, means)


def errors_of(place: Path, seed: int, name: str) -> Path:
    """The file of a camera set's errors in a probe's folder."""
    return place / f"seed{seed}" / f"{name}.csv"
