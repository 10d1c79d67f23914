"""Where a study stands."""

import os
import time
from pathlib import Path

import pytest
from study_files import BUFFER, UPDATES, write_run

from needlehoop.cli import main
from needlehoop.study.records import Place, read_study
from needlehoop.study.status import DONE, FAILED, MISSING, RUNNING, standings


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


def test_states_and_time_left(study):
    age(study / "rgb_default" / "human" / "seed0", 3600)
    found = {str(one.place): one for one in standings(read_study(study))}
    assert {name: one.state for name, one in found.items()} == {
        "dep_front+seg_side/human/seed0": DONE,
        "dep_front+seg_side/human/seed1": RUNNING,
        "rgb_default/human/seed0": FAILED,
        "rgb_default/human/seed1": MISSING,
    }
    running, failed = found["dep_front+seg_side/human/seed1"], found["rgb_default/human/seed0"]
    assert running.rate == pytest.approx(BUFFER / 16.0)
    assert running.left == pytest.approx((UPDATES - 60) * 16.0)
    assert failed.left == pytest.approx((UPDATES - 20) * 16.0)
    assert found["rgb_default/human/seed1"].left == pytest.approx(UPDATES * 16.0)


def test_a_run_between_two_slow_buffers_is_still_running(tmp_path):
    run = write_run(tmp_path / "main", "rgb_default", updates=20)
    age(run, 900)
    assert [one.state for one in standings(read_study(tmp_path / "main"))] == [FAILED]
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
    assert [one.state for one in standings(read_study(tmp_path / "main"))] == [RUNNING]


def test_expected_runs_may_be_named(study):
    wanted = [Place("seg_side", "human", 0), Place("dep_front+seg_side", "human", 0)]
    found = standings(read_study(study), wanted)
    assert [str(one.place) for one in found if one.state == MISSING] == ["seg_side/human/seed0"]
    assert len(found) == 4


def test_the_command_prints_a_table_and_what_was_left_out(study, capsys):
    (study / "rgb_default" / "human" / "seed0" / "manifest.json").write_text("{")
    age(study / "rgb_default" / "human" / "seed0", 3600)
    assert main(["status", str(study)]) == 0
    said = capsys.readouterr().out
    lines = [line.split() for line in said.splitlines()]
    assert ["dep_front+seg_side/human/seed0", "done", "100%", "640"] in lines
    assert ["dep_front+seg_side/human/seed1", "running", "62%", "640", "10", "min"] in lines
    assert ["rgb_default/human/seed1", "missing", "0%", "26", "min"] in lines
    assert "1 done, 1 running, 1 failed, 1 missing; 56 min left with 1 at a time" in said
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


def test_top_is_what_trains_cams_takes(capsys):
    assert main(["top", "paper"]) == 0
    assert capsys.readouterr().out == (
        "[dep_front,seg_side],[dep_front,rgb_side],[rgb_front,seg_side]\n"
    )
    assert main(["top", "paper", "--count", "1"]) == 0
    assert capsys.readouterr().out == "[dep_front,seg_side]\n"
    assert main(["top", "paper", "--count", "15"]) == 2
    assert "paper has 14 combinations" in capsys.readouterr().err
