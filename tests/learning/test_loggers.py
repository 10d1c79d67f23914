"""Where a run is shown besides its own files."""

import json
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import wandb
from tiny_runs import PLACE as TINY_PLACE
from tiny_runs import TINY, composed, run_composed, run_train

from needlehoop.learning.job import checked_job
from needlehoop.learning.loggers import Logger
from needlehoop.runs.run import Run

PLACE = "main/signals/sparse/seed0"
NOBODY = "http://127.0.0.1:9"
"""A port on which nothing listens."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    return folder


@pytest.fixture
def stranger(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A person whom wandb has never met, on a machine that does not reach its service."""
    for name in [name for name in os.environ if name.startswith("WANDB_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("NETRC", str(tmp_path / "home" / "netrc"))
    monkeypatch.setenv("WANDB_SILENT", "true")
    monkeypatch.setenv("WANDB_BASE_URL", NOBODY)
    monkeypatch.setenv("WANDB_HTTP_TIMEOUT", "1")
    for name in ("CONFIG", "CACHE", "DATA"):
        monkeypatch.setenv(f"WANDB_{name}_DIR", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    wandb.teardown()
    yield
    wandb.teardown()


def build(folder: Path, *loggers: str, mode: str = "auto", steps: int = 0):
    values = composed(*TINY)
    values |= {"logger": list(loggers) or ["wandb"], "wandb": {**values["wandb"], "mode": mode}}
    return Logger(checked_job(values), values, folder, steps)


def offline_run(folder: Path) -> Path:
    (found,) = (folder / "wandb").glob("offline-run-*")
    return found


def curves(folder: Path) -> bytes:
    """wandb's own record of an offline run, which its service completes when it ends."""
    wandb.teardown()
    (record,) = offline_run(folder).glob("run-*.wandb")
    return record.read_bytes()


def test_the_csv_logger_does_nothing_besides(folder):
    logger = build(folder, "csv")
    logger.log("train", {"step": 512, "return": 0.5})
    logger.video(folder / "missing.mp4")
    logger.close()
    assert list(folder.iterdir()) == []


@pytest.mark.usefixtures("stranger")
def test_wandb_offline_keeps_curves_and_video_in_the_runs_folder(folder):
    video = folder / "video.mp4"
    video.write_bytes(b"moving pictures")
    logger = build(folder, mode="offline")
    logger.log("train", {"step": 512, "return": 0.4375, "success": float("nan")})
    logger.log("evaluation", {"step": 512, "return": 0.8125})
    logger.log("train", {"step": 1024, "return": 0.5625, "success": 0.25})
    logger.video(video)
    logger.close()
    record = curves(folder)
    for name, value in (
        ("train/return", "0.4375"),
        ("evaluation/return", "0.8125"),
        ("train/return", "0.5625"),
        ("train/success", "0.25"),
    ):
        assert re.search(rf"{name}.{{1,6}}{value}".encode(), record, re.DOTALL), name
    assert PLACE.encode() in record
    assert b"NaN" not in record
    (kept,) = offline_run(folder).rglob("*.mp4")
    assert kept.read_bytes() == b"moving pictures"


def ids(folder: Path) -> list[str]:
    """Of the runs that wandb has records of, by its own names of their files."""
    wandb.teardown()
    records = (folder / "wandb").glob("offline-run-*/run-*.wandb")
    return [path.stem.removeprefix("run-") for path in records]


@pytest.mark.usefixtures("stranger")
def test_wandb_knows_a_resumed_run_by_one_id_and_a_new_run_by_another(tmp_path):
    folder, other = tmp_path / "run", tmp_path / "other"
    for place, steps in ((folder, 0), (folder, 512), (other, 0)):
        place.mkdir(exist_ok=True)
        logger = build(place, mode="offline", steps=steps)
        logger.log("train", {"step": steps + 512, "return": 0.5})
        logger.close()
        # Their folders are named by the second.
        time.sleep(1.1)
    first, second = ids(folder)
    assert first == second
    assert ids(other) != [first]


@pytest.mark.usefixtures("stranger")
def test_wandb_without_a_login_goes_offline_and_asks_nothing(folder, monkeypatch, capsys):
    def asked(*words):
        raise AssertionError(f"wandb asked: {words}")

    monkeypatch.setattr("builtins.input", asked)
    logger = build(folder, mode="auto")
    logger.log("train", {"step": 512, "return": 0.4375})
    logger.close()
    sent = f"offline; send it with: wandb sync {folder / 'wandb'}/offline-run-*"
    assert sent in capsys.readouterr().out
    assert b"0.4375" in curves(folder)


@pytest.mark.usefixtures("stranger")
@pytest.mark.parametrize("mode", ["auto", pytest.param("online", marks=pytest.mark.full)])
def test_wandb_with_a_login_but_no_service_goes_on_offline(folder, monkeypatch, mode):
    monkeypatch.setenv("WANDB_API_KEY", "0" * 40)
    settings, waits = wandb.Settings, iter([2])
    monkeypatch.setattr(
        wandb, "Settings", lambda **kw: settings(**{**kw, "init_timeout": next(waits, 30)})
    )
    wandb.teardown()
    logger = build(folder, mode=mode)
    logger.log("train", {"step": 512, "return": 0.4375})
    logger.close()
    assert b"0.4375" in curves(folder)


def test_a_run_of_one_logger_still_opens():
    """Before there could be several, wandb's settings were the logger's."""
    values = composed(*TINY)
    former = {"kind": "wandb", "project": "mine", "entity": "me", "mode": "offline"}
    del values["wandb"]
    job = checked_job({**values, "logger": former})
    assert job.logger == ("wandb",)
    assert (job.wandb.project, job.wandb.entity, job.wandb.mode) == ("mine", "me", "offline")


def points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows: steps and values by curve."""
    reading = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = reading.EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return {
        tag: [(one.step, one.value) for one in events.Scalars(tag)]
        for tag in events.Tags()["scalars"]
    }


def test_tensorboard_shows_curves_without_empty_numbers(folder):
    pytest.importorskip("tensorboard")
    logger = build(folder, "csv", "tensorboard")
    logger.log("train", {"step": 8, "return": 0.5, "success": float("nan")})
    logger.log("train", {"step": 16, "return": 0.75, "success": 0.25})
    logger.log("evaluation", {"step": 16, "return": 1.0})
    logger.video(folder / "missing.mp4")
    logger.close()
    found = points(folder)
    assert found["train/return"] == [(8, 0.5), (16, 0.75)]
    assert found["train/success"] == [(16, 0.25)]
    assert found["evaluation/return"] == [(16, 1.0)]


def test_a_resumed_run_has_each_point_once(tmp_path, monkeypatch):
    """Also those after the last checkpoint, which are made again."""
    pytest.importorskip("tensorboard")
    monkeypatch.chdir(tmp_path)
    words = [*TINY, "checkpoint_every=2", "evaluation.every=1", "logger=[csv,tensorboard]"]
    killed = Run.append

    def kill(run: Run, table: str, row: dict) -> None:
        if row["update"] == 2 and table == "evaluations.csv":
            raise RuntimeError("the machine is gone")
        killed(run, table, row)

    run_composed(composed(*words, "until=8"))
    monkeypatch.setattr(Run, "append", kill)
    with pytest.raises(RuntimeError, match="gone"):
        run_train(f"resume=results/{TINY_PLACE}")
    monkeypatch.setattr(Run, "append", killed)
    run_train(f"resume=results/{TINY_PLACE}")
    folder = tmp_path / "results" / TINY_PLACE
    assert json.loads((folder / "manifest.json").read_text())["finished"] is True
    for curve in ("train/length", "evaluation/success"):
        assert [step for step, _ in points(folder)[curve]] == [8, 16, 24], curve


def test_a_package_that_is_not_there_is_named_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("needlehoop.learning.loggers.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"logger: tensorboard is not .* 'needlehoop\[tensorb"):
        run_composed(composed(*TINY, "logger=[csv,tensorboard]"))
    assert list(tmp_path.iterdir()) == []
