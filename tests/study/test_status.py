"""Where a study stands."""

import json
import os
import time
from pathlib import Path

import pytest
from study_files import BUFFER, UPDATES, write_run

from needlehoop.cli.main import main
from needlehoop.study.data.records import read_study
from needlehoop.study.report.status import (
    DONE,
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
    write_run(folder, "rgb_default", seed=0, updates=20)
    return folder


def age(run: Path, seconds: float) -> None:
    then = time.time() - seconds
    for path in run.iterdir():
        os.utime(path, (then, then))


def stands(study: Path) -> dict[str, Standing]:
    ends, _ = read_job_ends(study)
    return {str(one.place): one for one in standings(read_study(study), ends)}


def note_outcome(study: Path, job: int, cameras: str, outcome: str, ago: float = 0.0) -> Path:
    """What a sweep's job leaves."""
    file = study.parent / ".sweeps" / "2026-11-21_12-00-00" / str(job) / "outcome.json"
    file.parent.mkdir(parents=True)
    note = {"run": "x", "study": study.name, "cameras": cameras, "reward": "human", "seed": 0}
    error = {"error": "RuntimeError: no memory"} if outcome == "failed" else {}
    file.write_text(json.dumps({**note, "outcome": outcome, **error}))
    then = time.time() - ago
    os.utime(file, (then, then))
    return file


def test_states_and_time_left(study):
    age(study / "rgb_default" / "human" / "seed0", 3600)
    found = stands(study)
    assert {name: one.state for name, one in found.items()} == {
        "dep_front+seg_side/human/seed0": DONE,
        "dep_front+seg_side/human/seed1": RUNNING,
        "rgb_default/human/seed0": STOPPED,
        "rgb_default/human/seed1": MISSING,
    }
    running, stopped = found["dep_front+seg_side/human/seed1"], found["rgb_default/human/seed0"]
    assert running.rate == pytest.approx(BUFFER / 16.0)
    assert running.left == pytest.approx((UPDATES - 60) * 16.0)
    assert stopped.left == pytest.approx((UPDATES - 20) * 16.0)
    assert found["rgb_default/human/seed1"].left == pytest.approx(UPDATES * 16.0)


def test_a_run_between_two_slow_buffers_is_still_running(tmp_path):
    run = write_run(tmp_path / "main", "rgb_default", updates=20)
    age(run, 900)
    assert [one.state for one in stands(tmp_path / "main").values()] == [STOPPED]
    # At 400 s a buffer, a quarter of an hour of silence means nothing.
    path = run / "metrics.csv"
    header, *lines = path.read_text().splitlines()
    slow = []
    for line in lines:
        cells = line.split(",")
        cells[2] = str(25 * float(cells[2]))
        slow.append(",".join(cells))
    path.write_text("\n".join([header, *slow, ""]))
    age(run, 900)
    assert [one.state for one in stands(tmp_path / "main").values()] == [RUNNING]


def test_a_stopped_run_says_so_until_it_goes_on(study):
    run = study / "rgb_default" / "human" / "seed0"
    manifest = json.loads((run / "manifest.json").read_text())
    age(run, 60)
    (run / "manifest.json").write_text(json.dumps({**manifest, "stopped": True}))
    assert stands(study)["rgb_default/human/seed0"].state == STOPPED
    with (run / "metrics.csv").open("a") as file:
        file.write("21,215040,336.0,640.0,60,1.0,0.0,0.0,0.0,0.5,0.0,150.0\n")
    # A buffer takes seconds; two writes in a row may share a tick of the disk's clock.
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
    found = stands(study)
    assert found["rgb_default/human/seed0"].state == FAILED
    assert found["rgb_default/human/seed0"].error == "RuntimeError: no memory"
    assert found["seg_side/human/seed0"].state == FAILED
    assert found["dep_side/human/seed0"].state == MISSING
    assert "dep_default/human/seed0" not in found
    assert main(["status", str(study)]) == 0
    assert "failed: seg_side/human/seed0: RuntimeError: no memory" in capsys.readouterr().out
    age(run, -1)
    assert stands(study)["rgb_default/human/seed0"].state == RUNNING


def test_a_note_that_cannot_be_read_is_named(study, capsys):
    note_outcome(study, 0, "rgb_default", "failed").write_text('{"run": ')
    note_outcome(study, 1, "rgb_default", "failed").write_text('{"study": "main"}')
    assert main(["status", str(study)]) == 0
    said = capsys.readouterr().out
    assert "../.sweeps/2026-11-21_12-00-00/0/outcome.json: is no JSON, or cut off" in said
    assert "1/outcome.json: has no usable cameras, reward, seed, outcome" in said


def test_an_experiment_says_what_nobody_has_started(study, tmp_path, capsys):
    words = ["experiment=table2", "seed=0,1", "steps=1_000_000"]
    assert main(["status", str(study), *words]) == 0
    said = capsys.readouterr().out
    assert "1 done, 2 running, 0 stopped, 0 failed, 25 missing" in said
    assert main(["status", str(tmp_path / "later"), *words]) == 0
    assert "28 missing; time left unknown" in capsys.readouterr().out
    assert main(["status", str(study), "cams=[seg_side,dep_front],seg_side"]) == 0
    said = capsys.readouterr().out
    assert "seg_side+dep_front/human/seed0" in said
    assert "0 done, 0 running, 0 stopped, 0 failed, 2 missing" in said
    assert "3 other runs are in" in said


def test_a_run_of_other_settings_is_not_what_was_asked_for(tmp_path, capsys):
    """Of ``make demo``'s size, say: finished, and none of an experiment's."""
    study = tmp_path / "main"
    write_run(study, "dep_front+seg_side", updates=2, steps=2 * BUFFER)
    assert main(["status", str(study), "experiment=table2"]) == 0
    said = capsys.readouterr().out
    assert "0 done, 0 running, 0 stopped, 0 failed, 13 missing, 1 with other settings" in said
    assert "other: dep_front+seg_side/human/seed0: steps=20480, not 1500000" in said
    # Fourteen runs of 1.5 M steps at 640 a second.
    assert "; 9 h 07 min left" in said
    assert main(["status", str(study), "cams=[dep_front,seg_side]", "steps=20_480"]) == 0
    assert "1 done" in capsys.readouterr().out
    words = ["cams=[dep_front,seg_side]", "steps=20_480", "algo.gamma=0.9"]
    assert main(["status", str(study), *words]) == 0
    assert "other: dep_front+seg_side/human/seed0: algo.gamma=0.99, not 0.9" in (
        capsys.readouterr().out
    )


def test_the_command_prints_a_table_and_what_was_left_out(study, capsys):
    (study / "rgb_default" / "human" / "seed0" / "manifest.json").write_text("{")
    age(study / "rgb_default" / "human" / "seed0", 3600)
    assert main(["status", str(study)]) == 0
    said = capsys.readouterr().out
    lines = [line.split() for line in said.splitlines()]
    assert ["dep_front+seg_side/human/seed0", "done", "100%", "640"] in lines
    running = ["dep_front+seg_side/human/seed1", "running", "62%", "640", "10", "min"]
    assert [*running, "0", "min", "ago"] in lines
    assert ["rgb_default/human/seed1", "missing", "0%", "26", "min"] in lines
    assert "1 done, 1 running, 1 stopped, 0 failed, 1 missing; 56 min left with 1 at a time" in said
    assert "left out: 1" in said
    assert "rgb_default/human/seed0/manifest.json: is no JSON, or cut off" in said


def test_a_study_without_rates_promises_nothing(tmp_path, capsys):
    run = write_run(tmp_path / "main", "rgb_default", updates=20)
    (run / "metrics.csv").unlink()
    assert main(["status", str(tmp_path / "main")]) == 0
    assert "time left unknown" in capsys.readouterr().out
    (tmp_path / "empty").mkdir()
    assert main(["status", str(tmp_path / "empty")]) == 0
    assert "no runs" in capsys.readouterr().out


def test_a_study_that_is_not_there(tmp_path, capsys):
    assert main(["status", str(tmp_path / "nowhere")]) == 2
    assert "no such folder" in capsys.readouterr().err
