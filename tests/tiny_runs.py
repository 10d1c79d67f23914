"""Runs that are over in a second, in this process, which has paid for the imports."""

from __future__ import annotations

import copy
import csv
import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from needlehoop.cli.train import run
from needlehoop.config import composing
from needlehoop.learning.job import typed_job
from needlehoop.learning.learner import Learner
from needlehoop.training.loop import start

TINY = [
    "obs=signals",
    "reward=sparse",
    "steps=24",
    "num_envs=2",
    "algo.horizon=4",
    "algo.minibatch=8",
    "algo.epochs=1",
    "algo.network.hidden=8",
    "algo.network.layers=1",
    "episode.max_steps=3",
    "episode.substeps=2",
    "evaluation.every=2",
    "evaluation.episodes=1",
    "evaluation.final_episodes=1",
    "evaluation.video_episodes=0",
    "checkpoint_every=1",
    "engine.threads=1",
]
"""Three buffers of eight steps, no image; an evaluation after the second."""

PLACE = "main/signals/sparse/seed0"
"""Where they are, below ``results``."""

CLOCKS = {"wall_time", "steps_per_second", "seconds_collect", "seconds_update", "memory_gb"}
"""Columns that differ between two runs of the same thing."""


def run_train(*words: str) -> None:
    """``python train.py``.

    Raises:
        SystemExit: as it ends, unless well.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["train.py"])
        run(words, "python train.py")


def composed(*words: str) -> dict[str, Any]:
    """The settings that a command line gives; most of a tiny run's time goes there."""
    return composing.compose(words, "config")


def run_composed(values: dict[str, Any]) -> None:
    """``python train.py``, below Hydra."""
    start(copy.deepcopy(values), [], "python train.py")


def refusal(*words: str) -> str:
    """The one line in which ``train.py`` refuses."""
    with pytest.raises(SystemExit) as caught:
        run_train(*words)
    message = str(caught.value.code)
    assert "\n" not in message
    return message


def learner(*words: str, state: Any = None) -> Learner:
    """What trains, of such words."""
    return Learner(typed_job(composing.compose(words, "job")), state)


def contents(folder: Path) -> dict[str, bytes]:
    """All files in a folder, by their paths in it."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def outcome(folder: Path) -> dict[str, Any]:
    """All that a finished run gives, without times; two of the same are equal to the bit."""
    assert json.loads((folder / "manifest.json").read_text())["finished"] is True
    state = torch.load(folder / "checkpoint.pt")
    return {
        "files": sorted(path.name for path in folder.iterdir()),
        "metrics": table(folder / "metrics.csv"),
        "evaluations": table(folder / "evaluations.csv"),
        "evaluation": (folder / "evaluation.json").read_text(),
        "weights": [(k, v.tolist()) for k, v in state["learner"]["ppo"]["agent"].items()],
        "best": best(folder / "best.safetensors"),
    }


def best(path: Path) -> tuple[dict[str, Any], str] | None:
    """Weights of the best policy, and the evaluation that it was the best at, without times."""
    if not path.exists():
        return None
    with safe_open(path, framework="pt") as file:
        noted = json.loads(file.metadata()["evaluation"])
    metrics = {name: value for name, value in noted.items() if name not in CLOCKS}
    return {name: one.tolist() for name, one in load_file(path).items()}, json.dumps(metrics)


def table(path: Path) -> list[dict[str, str]]:
    """Rows of a table without times; none where there is no table."""
    if not path.exists():
        return []
    rows = csv.DictReader(io.StringIO(path.read_text()))
    return [{k: v for k, v in row.items() if k not in CLOCKS} for row in rows]
