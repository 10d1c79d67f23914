"""A run as a model is shown it, to write a better program than the one that it was trained on."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from PIL import Image

from needlehoop.rewards.written import KINDS
from needlehoop.runs.files import METRICS, VIDEO
from needlehoop.runs.reading import UnreadableError, read_text
from needlehoop.runs.run import Run
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.prompts import fill

_ROWS, _STILLS = 10, 6
_TABLE = 64_000_000
"""Bytes of a table, at most."""


@dataclass(frozen=True)
class Trained:
    """A program, and what came of a training on it."""

    folder: str
    program: str
    origin: str
    """The file that the program came from."""
    curves: str
    """A table: step, return, terms, and the share of episodes in which the task was done."""
    steps: int
    stills: tuple[Png, ...]
    """Of the run's film, from its beginning to its end; none: there is no film."""

    @property
    def sha256(self) -> str:
        """Of the program."""
        return hashlib.sha256(self.program.encode()).hexdigest()

    def note(self) -> dict[str, str]:
        """Where a program descends from, for its file."""
        return {"run": self.folder, "program": self.origin, "sha256": self.sha256}

    def prompt(self, reward: Sequence[Part]) -> list[Part]:
        """The question for a better program, after the one that asked for the first."""
        (text, *pictures) = reward
        film = "Below the other pictures: stills of a film of the trained agent, in order."
        said = fill(
            "revise",
            reward=text,
            program=self.program.strip(),
            curves=self.curves,
            steps=f"{self.steps:,}",
            stills=film if self.stills else "There is no film of the trained agent.",
        )
        shown: list[Part] = [
            part
            for number, still in enumerate(self.stills, 1)
            for part in (f"trained agent, still {number} of {len(self.stills)}:", still)
        ]
        return [said, *pictures, *shown]


def read_run(folder: Path, size: int) -> Trained:
    """What a run's files say of its training.

    Args:
        folder: of the run.
        size: of a still's longer side, pixels, at most.

    Raises:
        ValueError: no run, one that was not paid by a program, or damaged files.
    """
    reward = Run.open(folder).config().get("reward")
    program = reward.get("program") if isinstance(reward, Mapping) else None
    kind = reward.get("kind") if isinstance(reward, Mapping) else None
    if not isinstance(program, Mapping) or kind not in KINDS:
        raise ValueError(f"revise: {folder} was trained on no program, so there is none to revise")
    try:
        rows = [*csv.DictReader(io.StringIO(read_text(folder / METRICS, _TABLE)))]
        steps = int(rows[-1]["step"]) if rows else 0
    except (UnreadableError, KeyError, ValueError) as error:
        raise ValueError(f"revise: {folder / METRICS}: {error}") from error
    if not rows:
        raise ValueError(f"revise: {folder / METRICS} has no rows yet")
    film = folder / VIDEO
    return Trained(
        str(folder),
        program["text"],
        program["origin"],
        _curves(rows),
        steps,
        _stills(film, size) if film.is_file() else (),
    )


def _curves(rows: Sequence[Mapping[str, str]]) -> str:
    """Some rows of the metrics, evenly over the training; terms by their names in the program."""
    # Facts would tell what success is.
    columns = ["step", "return", *(c for c in rows[0] if c.startswith("term_")), "success"]
    chosen = sorted({round(i * (len(rows) - 1) / (_ROWS - 1)) for i in range(_ROWS)})
    names = (column.removeprefix("term_") for column in columns[:-1])
    lines = [", ".join((*names, "done"))]
    for row in (rows[number] for number in chosen):
        values = (float(row[column] or "nan") for column in columns[1:])
        lines.append(", ".join([row["step"], *(f"{value:.3g}" for value in values)]))
    return "\n".join(lines)


def _stills(film: Path, size: int) -> tuple[Png, ...]:
    try:
        with imageio.get_reader(film) as opened:
            reader: Any = opened
            frames = [np.asarray(frame) for frame in reader]
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"revise: {film}: no film ({str(error).splitlines()[0]})") from error
    chosen = [round(i * (len(frames) - 1) / (_STILLS - 1)) for i in range(_STILLS)]
    return tuple(_png(frames[number], size) for number in chosen)


def _png(frame: np.ndarray, size: int) -> Png:
    still = Image.fromarray(frame)
    still.thumbnail((size, size))
    file = io.BytesIO()
    still.save(file, "PNG")
    return Png(file.getvalue())
