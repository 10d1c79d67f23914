"""A joblib sweep under signals: stopped in order, and one killed worker costs one run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tiny_runs import TINY

from needlehoop.runs.files import OUTCOME
from needlehoop.runs.lock import held
from needlehoop.training.sweep import attempt, summary

ROOT = Path(__file__).parents[2]
SWEEP = ["-m", *TINY, "results=results", "evaluation.every=0", "hydra.launcher.n_jobs=2"]


@pytest.fixture
def sweep(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A sweep over three seeds, two at a time, each far from its end."""
    words = [*SWEEP, "hydra/launcher=joblib", "seed=0,1,2", "steps=400000"]
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "train.py"), *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        start_new_session=True,
    )
    yield process
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    assert process.stdout is not None
    process.stdout.close()
    process.wait()


def folder(place: Path, seed: int) -> Path:
    return place / f"results/main/signals/sparse/seed{seed}"


def worker(place: Path, seed: int) -> int:
    """The process that trains a run, once it has a checkpoint."""
    lock, deadline = folder(place, seed).with_name(f".seed{seed}.lock"), time.monotonic() + 150
    while not (folder(place, seed) / "checkpoint.pt").exists():
        assert time.monotonic() < deadline, f"seed {seed} has no checkpoint"
        time.sleep(0.05)
    return json.loads(lock.read_text())["process"]


def manifest(place: Path, seed: int) -> dict:
    return json.loads((folder(place, seed) / "manifest.json").read_text())


def is_gone(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.full
def test_a_killed_worker_costs_its_run_and_sigterm_stops_the_others_in_order(tmp_path, sweep):
    first = [worker(tmp_path, 0), worker(tmp_path, 1)]
    os.kill(first[0], signal.SIGKILL)
    # The other goes on, and the third run takes the place that is free.
    third = worker(tmp_path, 2)
    assert not is_gone(first[1])
    sweep.send_signal(signal.SIGTERM)
    said, _ = sweep.communicate(timeout=60)
    assert sweep.returncode == 1
    assert "train.py: stopped; the same command goes on with the sweep" in said
    assert "Traceback" not in said
    assert all(is_gone(one) for one in (*first, third))
    for seed in (1, 2):
        assert manifest(tmp_path, seed)["stopped"] is True
    for seed in (0, 1, 2):
        with held(folder(tmp_path, seed)):
            pass


def test_the_summary_names_a_killed_run(tmp_path):
    note = {"run": "seed=0", "cameras": "signals", "reward": "sparse", "seed": 0}

    def killed() -> tuple[str, float]:
        (tmp_path / "1").mkdir()
        (tmp_path / "1" / OUTCOME).write_text((tmp_path / "0" / OUTCOME).read_text())
        return "done", 0.5

    (tmp_path / "0").mkdir()
    attempt(killed, tmp_path / "0", note)
    lines, undone = summary(tmp_path)
    assert lines == ["2 runs, 1 failed", "  signals/sparse/seed0: its process was killed"]
    assert undone == 1


@pytest.mark.full
def test_workers_stop_in_order_when_their_parent_is_killed(tmp_path, sweep):
    processes = [worker(tmp_path, 0), worker(tmp_path, 1)]
    sweep.kill()
    sweep.wait()
    deadline = time.monotonic() + 30
    while not all(is_gone(one) for one in processes):
        assert time.monotonic() < deadline, "a worker trains on without its parent"
        time.sleep(0.05)
    assert [manifest(tmp_path, seed)["stopped"] for seed in (0, 1)] == [True, True]
