"""Where a run is shown besides its own files."""

import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import wandb
from tiny_runs import PLACE, TINY, composed

from needlehoop.learning.job import checked_job
from needlehoop.learning.loggers import Logger


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    return folder


@pytest.fixture
def stranger(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A person without a login at wandb, on a machine that does not reach its service."""
    for name in [name for name in os.environ if name.startswith("WANDB_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("NETRC", str(tmp_path / "home" / "netrc"))
    monkeypatch.setenv("WANDB_SILENT", "true")
    # A port on which nothing listens.
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")
    for name in ("CONFIG", "CACHE", "DATA"):
        monkeypatch.setenv(f"WANDB_{name}_DIR", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    wandb.teardown()
    yield
    wandb.teardown()


def build(folder: Path, *loggers: str, mode: str = "offline", steps: int = 0) -> Logger:
    values = composed(*TINY)
    values |= {"logger": list(loggers), "wandb": {**values["wandb"], "mode": mode}}
    return Logger(checked_job(values), values, folder, steps)


def records(folder: Path) -> list[Path]:
    """wandb's own files of offline runs, which its service completes when it ends."""
    wandb.teardown()
    return [*(folder / "wandb").glob("offline-run-*/run-*.wandb")]


@pytest.mark.usefixtures("stranger")
def test_wandb_without_a_login_keeps_curves_and_video_in_the_runs_folder(folder, capsys):
    video = folder / "video.mp4"
    video.write_bytes(b"moving pictures")
    logger = build(folder, "wandb", mode="auto")
    logger.log("train", {"step": 512, "return": 0.4375, "success": float("nan")})
    logger.log("evaluation", {"step": 512, "return": 0.8125})
    logger.video(video)
    logger.close()
    assert "offline; send it with: wandb sync" in capsys.readouterr().out
    (path,) = records(folder)
    record = path.read_bytes()
    for name, value in (("train/return", "0.4375"), ("evaluation/return", "0.8125")):
        assert re.search(rf"{name}.{{1,6}}{value}".encode(), record, re.DOTALL), name
    assert PLACE.encode() in record
    assert b"NaN" not in record
    (kept,) = path.parent.rglob("*.mp4")
    assert kept.read_bytes() == b"moving pictures"
    # It knows a run that goes on by its id; its folders are named by the second.
    time.sleep(1.1)
    build(folder, "wandb", steps=512).close()
    assert [again.name for again in records(folder)] == [path.name] * 2


def test_tensorboard_shows_each_point_once_and_no_empty_numbers(folder):
    """Also after a resume, which makes the points after the last checkpoint again."""
    reading = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    for steps, rows in ((0, {8: 0.5, 16: 0.625}), (8, {16: 0.75, 24: float("nan")})):
        logger = build(folder, "csv", "tensorboard", steps=steps)
        for step, value in rows.items():
            logger.log("train", {"step": step, "return": value})
        logger.close()
    events = reading.EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert [(p.step, p.value) for p in events.Scalars("train/return")] == [(8, 0.5), (16, 0.75)]
