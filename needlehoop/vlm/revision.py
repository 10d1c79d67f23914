"""A run as a model is shown it, to write a better program than the one that it was trained on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from PIL import Image

from needlehoop.rewards.written import KINDS
from needlehoop.runs.files import METRICS, VIDEO
from needlehoop.runs.reading import UnreadableError
from needlehoop.runs.run import Run
from needlehoop.study.data.contents import RETURN_RANGE, Rows, read_rows
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.prompts import fill

_ROWS, _STILLS = 10, 6

_RANGES = {"return": RETURN_RANGE, "success": (0.0, 1.0)}
"""Columns that rows of the metrics must have; they are empty before any episode has ended."""


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
        rows, _ = read_rows(folder / METRICS, _RANGES, folder)
    except UnreadableError as error:
        raise ValueError(f"revise: {folder / METRICS} {error}") from error
    film = folder / VIDEO
    return Trained(
        str(folder),
        program["text"],
        program["origin"],
        _curves(rows),
        int(rows["step"][-1]),
        _stills(film, size) if film.is_file() else (),
    )


def _curves(rows: Rows) -> str:
    """Some rows of the metrics, evenly over the training; terms by their names in the program."""
    # Facts would tell what success is.
    columns = ["return", *(c for c in rows if c.startswith("term_")), "success"]
    names = (column.removeprefix("term_") for column in columns[:-1])
    lines = [", ".join(("step", *names, "done"))]
    for row in sorted({round(i * (len(rows["step"]) - 1) / (_ROWS - 1)) for i in range(_ROWS)}):
        values = (f"{rows[column][row]:.3g}" for column in columns)
        lines.append(", ".join((f"{rows['step'][row]:.0f}", *values)))
    return "\n".join(lines)


def _stills(film: Path, size: int) -> tuple[Png, ...]:
    try:
        with imageio.get_reader(film) as opened:
            reader: Any = opened
            frames = [np.asarray(frame) for frame in reader]
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"revise: {film}: no film ({str(error).splitlines()[0]})") from error
    chosen = [round(i * (len(frames) - 1) / (_STILLS - 1)) for i in range(_STILLS)]
    return tuple(Png.of(Image.fromarray(frames[number]), size) for number in chosen)
