"""Where a study stands."""

import json
import os
import time
from pathlib import Path

import pytest
from study_files import BUFFER, change, write_run

from needlehoop.cli.main import main
from needlehoop.study.data.records import read_study
from needlehoop.study.report.status import (
    FAILED,
    MISSING,
    RUNNING,
    STOPPED,
    Standing,
    read_job_ends,
    standings,
)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """One run of each state; a buffer takes 16 s."""
    folder = tmp_path / "main"
    write_run(folder, "dep_front+seg_side", seed=0)
    write_run(folder, "dep_front+seg_side", seed=1, updates=60)
    age(write_run(folder, "rgb_default", seed=0, updates=20), 3600)
    return folder


def age(run: Path, seconds: float) -> None:
    then = time.time() - seconds
    for path in run.iterdir():
        os.utime(path, (then, then))


def stands(study: Path) -> dict[str, Standing]:
    runs = standings(read_study(study), read_job_ends(study))
    return {str(run.place): run for run in runs}


def note_outcome(study: Path, job: int, cameras: str, outcome: str, ago: float = 0.0) -> None:
    """What a sweep's job leaves."""
    file = study.parent / ".sweeps" / "2026-11-21_12-00-00" / str(job) / "outcome.json"
    file.parent.mkdir(parents=True)
    note = {"run": "x", "study": study.name, "cameras": cameras, "reward": "human", "seed": 0}
    error = {"error": "RuntimeError: no memory"} if outcome == "failed" else {}
    file.write_text(json.dumps({**note, "outcome": outcome, **error}))
    then = time.time() - ago
    os.utime(file, (then, then))


def test_a_run_between_two_slow_buffers_is_still_running(tmp_path):
    run = write_run(tmp_path / "main", "rgb_default", updates=20)
    # At 400 s a buffer, a quarter of an hour of silence means nothing.
    lines = [f"{i},{i * BUFFER},{400 * i},1.0,0.5" for i in range(1, 21)]
    text = "\n".join(["update,step,wall_time,return,success", *lines, ""])
    (run / "metrics.csv").write_text(text)
    age(run, 900)
    assert [one.state for one in stands(tmp_path / "main").values()] == [RUNNING]


def test_a_stopped_run_says_so_until_it_goes_on(study):
    run = study / "rgb_default" / "human" / "seed0"
    age(run, 60)
    change(run / "manifest.json", stopped=True)
    assert stands(study)["rgb_default/human/seed0"].state == STOPPED
    later = (run / "manifest.json").stat().st_mtime + 1.0
    os.utime(run / "metrics.csv", (later, later))
    assert stands(study)["rgb_default/human/seed0"].state == RUNNING


def test_a_failed_job_of_a_sweep_is_a_failed_run_until_it_goes_on(study, capsys):
    run = study / "rgb_default" / "human" / "seed0"
    age(run, 60)
    note_outcome(study, 0, "rgb_default", "failed")
    note_outcome(study, 1, "seg_side", "failed")
    # Only the newest outcome of a run counts.
    note_outcome(study, 2, "dep_side", "failed", ago=50)
    note_outcome(study, 3, "dep_side", "stopped")
    note_outcome(study.parent / "other", 4, "dep_default", "failed")
    runs = stands(study)
    assert runs["rgb_default/human/seed0"].state == FAILED
    assert runs["rgb_default/human/seed0"].error == "RuntimeError: no memory"
    assert runs["seg_side/human/seed0"].state == FAILED
    assert runs["dep_side/human/seed0"].state == MISSING
    assert "dep_default/human/seed0" not in runs
    assert main(["status", str(study)]) == 0
    assert "failed: seg_side/human/seed0: RuntimeError: no memory" in capsys.readouterr().out
    age(run, -1)
    assert stands(study)["rgb_default/human/seed0"].state == RUNNING


def test_the_command_prints_a_table_and_what_was_left_out(study, capsys):
    bad = write_run(study, "seg_side", updates=20)
    (bad / "manifest.json").write_text("{")
    assert main(["status", str(study)]) == 0
    output = capsys.readouterr().out
    lines = [line.split() for line in output.splitlines()]
    assert ["dep_front+seg_side/human/seed0", "done", "100%", "640"] in lines
    assert ["dep_front+seg_side/human/seed1", "running", "62%", "640", "10", "min"] in lines
    assert ["rgb_default/human/seed0", "stopped", "21%", "640", "21", "min"] in lines
    assert ["rgb_default/human/seed1", "missing", "0%", "26", "min"] in lines
    tally = "1 done, 1 running, 1 stopped, 0 failed, 1 missing; 56 min of training left"
    assert f"{tally} with 1 at a time" in output
    assert "left out: seg_side/human/seed0: manifest.json: " in output
