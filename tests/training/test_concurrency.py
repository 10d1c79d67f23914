"""Two processes and one folder: one of them works there, and the other is told so."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tiny_runs import PLACE, TINY, outcome, refusal, run_train

ROOT = Path(__file__).parents[2]
RUN = Path("results") / PLACE
LONG = [*TINY, "steps=160", "evaluation.every=0", "results=results"]


def start(place: Path, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(ROOT / "train.py"), *words],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if not path.name.endswith(".partial")}


@pytest.mark.full
def test_a_run_under_way_is_left_to_its_process(tmp_path, monkeypatch, capfd):
    """Resumed, begun anew and swept over while it is under way; then stopped, and gone on with."""
    monkeypatch.chdir(tmp_path)
    process = start(tmp_path, *LONG)
    try:
        while not (RUN / "checkpoint.pt").exists():
            assert process.poll() is None, process.communicate()[0]
            time.sleep(0.02)
        # It works on its buffer as long as we look.
        process.send_signal(signal.SIGSTOP)
        before = files(RUN.parent)
        holder = "seed0: a run is training there"
        assert holder in refusal(f"resume={RUN}")
        assert holder in refusal(*LONG, "overwrite=true")
        assert holder in refusal(*LONG, "existing=resume")
        with pytest.raises(SystemExit) as caught:
            run_train("-m", *LONG, "seed=0")
        assert caught.value.code == 1
        assert "1 runs, 0 failed, 1 under way elsewhere" in capfd.readouterr().out
        assert files(RUN.parent) == before
        assert process.poll() is None
    finally:
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGCONT)
        said, _ = process.communicate(timeout=60)
    assert "stopped; go on with: python train.py resume=results/main" in said
    run_train(f"resume={RUN}")
    updates = [int(row["update"]) for row in outcome(RUN)["metrics"]]
    assert updates == list(range(1, 21))


@pytest.mark.full
def test_two_sweeps_at_once_make_each_run_once(tmp_path):
    words = ["-m", *TINY, "results=results", "seed=0,1,2", "steps=48"]
    processes = [start(tmp_path, *words) for _ in range(2)]
    said = [process.communicate(timeout=300)[0] for process in processes]
    assert all("3 runs, 0 failed" in one for one in said), said
    for seed in range(3):
        rows = outcome(tmp_path / RUN.with_name(f"seed{seed}"))["metrics"]
        assert [row["update"] for row in rows] == [str(n) for n in range(1, 7)]
    assert not list((tmp_path / "results" / "main").rglob("*.partial"))
