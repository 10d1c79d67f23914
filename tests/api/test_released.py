"""Trained agents packed for a release, and found by their cameras."""

import csv
import hashlib
import json
import lzma
from pathlib import Path

import numpy as np
import pytest
from tiny_runs import TINY, composed, run_composed

import needlehoop
from needlehoop.api import trained as agents_of_runs
from needlehoop.cli.main import main

IMAGES = [*(word for word in TINY if not word.startswith("obs")), "image_size=16"]
OBSERVATION = {
    "rgb_side": np.zeros((16, 16, 3), np.uint8),
    "dep_front": np.full((16, 16, 4), 90, np.uint8),
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """A study of two camera sets; the second seed of one of them does better."""
    place = tmp_path_factory.mktemp("place")
    for cams in ("dep_front,rgb_side", "seg_side"):
        for seed in (0, 1) if "," in cams else (0,):
            words = [f"cams=[{cams}]", f"seed={seed}", f"results={place}/results"]
            run_composed(composed(*IMAGES, *words))
    study = place / "results" / "main"
    better = study / "dep_front+rgb_side" / "sparse" / "seed1" / "evaluation.json"
    better.write_text(json.dumps({**json.loads(better.read_text()), "success": 1.0}))
    return study


def test_a_packed_agent_acts_as_its_run_does(trained, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["pack", str(trained)]) == 0
    assert "agents/seg_side.safetensors.xz" in capsys.readouterr().out
    agents = tmp_path / "agents"
    for line in (agents / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split("  ")
        assert hashlib.sha256((agents / name).read_bytes()).hexdigest() == digest
    with (agents / "agents.csv").open(newline="") as file:
        rows = {row["cameras"]: row for row in csv.DictReader(file)}
    assert (rows["dep_front+rgb_side"]["seed"], rows["dep_front+rgb_side"]["success"]) == (
        "1",
        "1.0",
    )
    packed = agents / "dep_front+rgb_side.safetensors.xz"
    with pytest.raises(ValueError, match="is packed; unpack it with: xz --decompress agents/dep_"):
        needlehoop.load_policy("dep_front+rgb_side")
    (agents / packed.stem).write_bytes(lzma.decompress(packed.read_bytes()))
    own = needlehoop.load_policy(trained / "dep_front+rgb_side" / "sparse" / "seed1")
    # In whatever order the cameras are named.
    found = needlehoop.load_policy("rgb_side,dep_front")
    np.testing.assert_allclose(found(OBSERVATION), own(OBSERVATION), atol=0.02)
    other = needlehoop.load_policy(trained / "dep_front+rgb_side" / "sparse" / "seed0")
    assert np.abs(other(OBSERVATION) - own(OBSERVATION)).max() > 0.02


def test_cameras_without_an_agent_are_told_how_to_train_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = r"python train\.py algo=dagger cams=dep_front,rgb_side"
    with pytest.raises(ValueError, match=command):
        needlehoop.load_policy("dep_front+rgb_side")
    with pytest.raises(ValueError, match="nowhere: no such file"):
        needlehoop.load_policy("nowhere")


def test_what_cannot_be_packed_is_said_and_leaves_nothing(trained, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "mine").mkdir()
    assert main(["pack", "empty"]) == 2
    assert "no finished run has a policy.safetensors" in capsys.readouterr().err
    assert main(["pack", str(trained), "--out", "mine"]) == 2
    assert "--out: 'mine' exists" in capsys.readouterr().err
    monkeypatch.setattr(agents_of_runs, "_LARGEST", 1_000)
    assert main(["pack", str(trained)]) == 2
    assert "a released agent may have 1,000" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "mine"]
