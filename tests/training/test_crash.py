"""Runs and sweeps killed at any operation on their files: they go on to the same bits.

``CRASH_POINTS`` says at how many of the operations, evenly spread (``strength.py``).
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import torch
from strength import ALL, CRASH_POINTS
from tiny_runs import PLACE, TINY, composed, outcome, refusal, run_composed, run_train

from needlehoop.runs import run as run_files

SWEEP_POINTS = max(2, CRASH_POINTS // 6)

RUN = [*TINY, "existing=resume", "results=results"]
SWEEP = ["-m", *TINY, "seed=0,1", "steps=8", "evaluation.every=0", "results=results"]

OPERATIONS = {
    os: [
        *("open", "replace", "rename", "unlink", "remove", "mkdir", "rmdir"),
        *("truncate", "ftruncate", "pwrite", "fsync"),
    ],
    io: ["open"],
}
"""By which files and folders come, change and go; ``pathlib`` and ``shutil`` look them up here."""


_OPENERS = (os.open, io.open)


class Killed(BaseException):
    """The process is no more: nobody handles this, and nothing that is tried after it is done."""


class Machine:
    """Counts operations on files, and kills at one of them."""

    def __init__(self, at: int = 0):
        self.at, self.done = at, 0

    def operate(self, real: Callable[..., Any], *given: Any, **named: Any) -> Any:
        if real in _OPENERS and not _writes(given, named):
            return real(*given, **named)
        self.done += 1
        if self.at and self.done >= self.at:
            raise Killed
        return real(*given, **named)


def _writes(given: tuple[Any, ...], named: dict[str, Any]) -> bool:
    how = given[1] if len(given) > 1 else named.get("mode", "r")
    if isinstance(how, str):
        return how[0] in "wax" or "+" in how
    return bool(how & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


@contextmanager
def machine(at: int = 0) -> Iterator[Machine]:
    """One that counts, or kills. What its dead process held is free afterwards: it is closed."""
    own = Machine(at)
    with pytest.MonkeyPatch.context() as patch:
        for module, names in OPERATIONS.items():
            for name in names:
                real = getattr(module, name)
                patch.setattr(module, name, lambda *a, _real=real, **k: own.operate(_real, *a, **k))
        try:
            yield own
        except Killed:
            return


def killed(run: Callable[[], None], at: int) -> bool:
    """Whether a process that is to be killed at an operation got that far."""
    with machine(at) as own:
        run()
    return own.done >= at


def litter(place: Path) -> list[str]:
    """What is half-made; the file of a lock that nobody holds is nothing."""
    return [
        str(path.relative_to(place))
        for path in place.rglob("*")
        if path.name.endswith((".partial", ".new"))
    ]


Run = Callable[[], None]


@pytest.fixture(scope="module")
def run() -> Run:
    """Begins the run, or goes on with it."""
    return partial(run_composed, composed(*RUN))


@pytest.fixture(scope="module")
def whole(run, tmp_path_factory) -> tuple[dict[str, Any], int]:
    """What the run gives that is left alone, and how many operations it takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("whole"))
        with machine() as own:
            run()
        return outcome(Path("results") / PLACE), own.done


def spread(points: int, among: int) -> list[int]:
    """So many numbers from 1 to ``among``, the first and the last included."""
    return sorted({1 + round(i * (among - 1) / (points - 1)) for i in range(points)})


def test_a_run_killed_at_any_operation_goes_on_to_the_same_bits(run, whole, tmp_path, monkeypatch):
    expected, operations = whole
    points = spread(min(CRASH_POINTS, operations), operations)
    deaths = 0
    for point in points:
        place = tmp_path / str(point)
        place.mkdir()
        monkeypatch.chdir(place)
        deaths += killed(run, point)
        run()
        assert outcome(Path("results") / PLACE) == expected, point
        assert litter(place) == [], point
        seeds = {path.name for path in (Path("results") / PLACE).parent.iterdir()}
        assert seeds <= {"seed0", ".seed0.lock"}, point
    assert deaths >= min(CRASH_POINTS, operations) - 4


def test_a_run_killed_between_the_best_policy_and_the_checkpoint(run, whole, tmp_path, monkeypatch):
    """The file of the best is then ahead of the checkpoint, which is of an earlier buffer."""
    monkeypatch.chdir(tmp_path)
    real = run_files.write_checkpoint
    kept = Path("results") / PLACE / "best.safetensors"

    def write(path: Path, checkpoint: Any) -> None:
        if kept.exists():
            raise Killed
        real(path, checkpoint)

    with monkeypatch.context() as patch:
        patch.setattr(run_files, "write_checkpoint", write)
        with machine():
            run()
    assert kept.exists()
    assert torch.load(kept.with_name("checkpoint.pt"))["update"] == 1
    # The next one writes it anew, with the same bits.
    kept.write_bytes(b"")
    run()
    assert outcome(Path("results") / PLACE) == whole[0]


def test_a_run_killed_while_it_goes_on_goes_on_again(run, whole, tmp_path, monkeypatch):
    """At several operations one after the other, of one and the same run."""
    monkeypatch.chdir(tmp_path)
    for number in range(1, 11 if ALL else 5):
        if not killed(run, 12 + number):
            break
    run()
    assert outcome(Path("results") / PLACE) == whole[0]


def test_a_run_killed_while_another_is_set_aside_loses_neither(run, whole, tmp_path, monkeypatch):
    other = partial(run_composed, composed(*RUN, "steps=8", "evaluation.every=0"))
    anew = partial(run_composed, composed(*RUN, "overwrite=true"))
    for point in (2, 5, 8, 11, 12, 13, 14, 16) if ALL else (5, 13):
        place = tmp_path / str(point)
        place.mkdir()
        monkeypatch.chdir(place)
        other()
        first = (Path("results") / PLACE / "metrics.csv").read_bytes()
        assert killed(anew, point)
        anew() if (Path("results") / PLACE).exists() else run()
        assert outcome(Path("results") / PLACE) == whole[0], point
        kept = [path.read_bytes() for path in Path("results").rglob("seed0.*/metrics.csv")]
        assert first in kept, point


def test_a_sweep_killed_at_any_operation_does_the_rest(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    with machine() as own:
        run_train(*SWEEP)
    seeds = [str(Path("results") / PLACE).replace("seed0", f"seed{seed}") for seed in (0, 1)]
    expected = [outcome(Path(seed)) for seed in seeds]
    for point in spread(SWEEP_POINTS, own.done):
        place = tmp_path / str(point)
        place.mkdir()
        monkeypatch.chdir(place)
        killed(partial(run_train, *SWEEP), point)
        run_train(*SWEEP)
        assert "2 runs, 0 failed" in capfd.readouterr().out, point
        assert [outcome(Path(seed)) for seed in seeds] == expected, point
        assert litter(place / "results" / "main") == [], point


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    real = os.fsync
    done = count()

    def full(descriptor: int) -> None:
        if next(done) == 7:
            raise OSError(28, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    said = refusal(*RUN)
    assert "No space left on device" in said
    assert "results/main" in said
