"""The files of a probe: settings, and for each seed and combination the errors by episode."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from needlehoop.files import CONFIG, MANIFEST, write_whole
from needlehoop.probe.frames import KINDS, PHASES
from needlehoop.probe.scores import QUANTITIES, Errors
from needlehoop.provenance import provenance

_ANY = ("cams", "seeds", "results", "study", "overwrite", "device", "engine")
"""Settings that may change from one call to the next: more of the same is added."""

_COLUMNS = [
    "episode",
    "kind",
    *(f"{phase}_frames" for phase in PHASES),
    *(f"{phase}_{quantity}" for phase in PHASES for quantity in QUANTITIES),
]


class Folder:
    """A probe's folder; what is in it is not done again.

    Args:
        path: made where missing.
        config: the composed settings, as plain values.
        overwrite: whether errors that are there are dropped.

    Raises:
        ValueError: the folder holds something else, or a probe with other settings.
    """

    def __init__(self, path: Path, config: Mapping[str, Any], overwrite: bool):
        self.path = path
        own, held = dict(config), path / CONFIG
        if path.exists() and any(file.is_file() for file in path.iterdir()):
            before = yaml.safe_load(held.read_text()) if held.is_file() else None
            if not isinstance(before, dict) or "fit" not in before:
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
                    shutil.rmtree(old)
        path.mkdir(parents=True, exist_ok=True)
        write_whole(held, yaml.safe_dump(own, sort_keys=False))

    def note(self, **facts: Any) -> None:
        """Write the manifest: where the files come from, and ``facts``."""
        write_whole(self.path / MANIFEST, json.dumps({**provenance(), **facts}, indent=2) + "\n")

    def has(self, seed: int, name: str) -> bool:
        """Whether a combination's errors are there."""
        return self._file(seed, name).exists()

    def names(self, seeds: int) -> list[str]:
        """Combinations whose errors are there for every seed below ``seeds``."""
        found = [
            {file.stem for file in (self.path / f"seed{s}").glob("*.csv")} for s in range(seeds)
        ]
        return sorted(set.intersection(*found))

    def save(self, seed: int, name: str, found: Errors) -> None:
        """Write a combination's errors, whole or not at all."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for episode, (mean, frames) in enumerate(zip(found.mean, found.frames, strict=True)):
            cells = ["" if np.isnan(value) else f"{value:.4g}" for value in mean.flatten()]
            writer.writerow([episode, KINDS[episode % len(KINDS)], *frames, *cells])
        path = self._file(seed, name)
        path.parent.mkdir(exist_ok=True)
        write_whole(path, text.getvalue())

    def load(self, seed: int, name: str) -> Errors:
        """A combination's errors.

        Raises:
            ValueError: the file is not one that ``save`` wrote.
        """
        path = self._file(seed, name)
        with path.open(newline="") as file:
            header, *rows = csv.reader(file)
        if header != _COLUMNS or any(len(row) != len(header) for row in rows):
            raise ValueError(f"{path} is not a probe's; delete it to have it made again")
        first = 2 + len(PHASES)
        values = [[float(cell) if cell else np.nan for cell in row[first:]] for row in rows]
        frames = [[int(cell) for cell in row[2:first]] for row in rows]
        return Errors(
            np.array(values).reshape(len(rows), len(PHASES), len(QUANTITIES)), np.array(frames)
        )

    def _file(self, seed: int, name: str) -> Path:
        return self.path / f"seed{seed}" / f"{name}.csv"
