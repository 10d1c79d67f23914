"""How long commands take that need no simulator and no agent, beside ``import torch``."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import needlehoop
from needlehoop.bench.waiting import rounds_of
from needlehoop.runs.machine import machine

_TORCH = "import torch"
_COMMAND = ("-m", "needlehoop.cli.main")
_PROGRAM = "bad.txt"

CALLS: Mapping[str, tuple[tuple[str, ...], int]] = {
    _TORCH: (("-c", _TORCH), 0),
    "--help": ((*_COMMAND, "--help"), 0),
    "signals": ((*_COMMAND, "signals"), 0),
    "status": ((*_COMMAND, "status", "study", "experiment=table2"), 0),
    "vlm check of a program that does not compile": ((*_COMMAND, "vlm", "check", _PROGRAM), 1),
    "train --help": ((*_COMMAND, "train", "--help"), 0),
    "train with a misspelt key": ((*_COMMAND, "train", "cams=dep_front", "stpes=9"), 1),
}
"""Words after ``python``, and the exit status that they end with, by name."""


def measure_startup(
    rounds: int, calls: Mapping[str, tuple[Sequence[str], int]] = CALLS
) -> dict[str, object]:
    """Seconds of each call, from its start to its end, and their ratios to ``import torch``.

    The calls take turns, so what else the machine does hits all of them; a ratio is the
    median of those within a round.

    Args:
        rounds: how often.
        calls: what to call, ``import torch`` among them.

    Raises:
        ValueError: ``rounds`` below 1.
        RuntimeError: a call ended with another exit status than it should.
    """
    if rounds < 1:
        raise ValueError(f"rounds: {rounds} must be at least 1")
    with TemporaryDirectory() as folder:
        (Path(folder) / _PROGRAM).write_text("reward = nonsense(needle_tip)\n")
        taken = [
            {name: _time(words, status, folder) for name, (words, status) in calls.items()}
            # One more: the first reads the files from the disk, and may compile them.
            for _ in rounds_of(rounds + 1, "round")
        ][1:]
    return {
        "machine": machine(),
        "rounds": rounds,
        "seconds": {name: round(median(one[name] for one in taken), 2) for name in calls},
        "ratio_to_import_torch": {
            name: round(median(one[name] / one[_TORCH] for one in taken), 2)
            for name in calls
            if name != _TORCH
        },
    }


def _time(words: Sequence[str], status: int, folder: str) -> float:
    """Seconds of one call of Python, in a folder with this needlehoop to import."""
    home = str(Path(needlehoop.__file__).parents[1])
    paths = os.pathsep.join(filter(None, (home, os.environ.get("PYTHONPATH"))))
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    seconds = time.perf_counter() - began
    if done.returncode != status:
        raise RuntimeError(
            f"{' '.join(words)}: exit status {done.returncode}, not {status}: {done.stderr.strip()}"
        )
    return seconds
