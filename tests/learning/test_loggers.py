"""Where a run is shown besides its own files."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import wandb

from needlehoop.learning.job import LoggerConfig
from needlehoop.learning.metrics import build_logger

PLACE = "main/dep_front+seg_side/human/seed0"
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


def build(folder: Path, kind: str = "wandb", mode: str = "auto"):
    config = LoggerConfig(kind=kind, project="needlehoop", entity=None, mode=mode)
    return build_logger(config, PLACE, {"steps": 512, "cams": ["dep_front"]}, folder)


def offline_run(folder: Path) -> Path:
    (found,) = (folder / "wandb").glob("offline-run-*")
    return found


def curves(folder: Path) -> bytes:
    """wandb's own record of an offline run, which its service completes when it ends."""
    wandb.teardown()
    (record,) = offline_run(folder).glob("run-*.wandb")
    return record.read_bytes()


def test_the_csv_logger_does_nothing_besides(folder):
    logger = build(folder, kind="csv")
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


@pytest.mark.usefixtures("stranger")
def test_wandb_without_a_login_goes_offline_and_asks_nothing(folder, monkeypatch):
    def asked(*words):
        raise AssertionError(f"wandb asked: {words}")

    monkeypatch.setattr("builtins.input", asked)
    logger = build(folder, mode="auto")
    logger.log("train", {"step": 512, "return": 0.4375})
    logger.close()
    assert b"0.4375" in curves(folder)


@pytest.mark.usefixtures("stranger")
@pytest.mark.parametrize("mode", ["auto", "online"])
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
