"""Going on with runs: nobody else at work in them, nothing half-made, nothing of another run."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from tiny_runs import PLACE, TINY, composed, contents, outcome, run_composed

from needlehoop.runs.machine import HeldError, held


class KilledError(BaseException):
    """The process is no more: nobody handles this."""


def train_until(write: int, values: dict[str, Any]) -> None:
    """Train, and be killed instead of writing a file for the ``write``-th time."""
    real, written = os.fsync, []

    def counted(file: int) -> None:
        if len(written) == write:
            raise KilledError
        written.append(file)
        real(file)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", counted)
        with pytest.raises(KilledError):
            run_composed(values)


@pytest.fixture(scope="module")
def whole(tiny_run) -> dict[str, Any]:
    """What the run gives that is left alone."""
    return outcome(tiny_run)


@pytest.fixture(scope="module")
def killed(tmp_path_factory) -> Path:
    """The results of a run that ended in its third buffer."""
    results = tmp_path_factory.mktemp("killed")
    train_until(13, composed(*TINY, f"results={results}"))
    return results


@pytest.fixture
def folder(killed: Path, elsewhere: Path) -> Iterator[Path]:
    """A copy of it; whatever is done there, nothing half-made is left."""
    shutil.copytree(killed, elsewhere / "results")
    yield Path("results") / PLACE
    left = [str(path) for path in elsewhere.rglob("*")]
    assert not [path for path in left if path.endswith((".partial", ".new", ".lock"))]


# The first checkpoint, the third, the last note.
@pytest.mark.parametrize("write", [5, 13, 17])
def test_a_run_killed_while_it_writes_goes_on_to_the_same_bits(write, whole, elsewhere):
    values, folder = composed(*TINY, "existing=resume"), Path("results") / PLACE
    train_until(write, values)
    run_composed(values if write == 5 else composed(f"resume={folder}"))
    assert outcome(folder) == whole
    assert [path.name for path in folder.parent.iterdir()] == ["seed0"]


def test_a_run_under_way_is_left_alone(folder):
    before = contents(folder)
    with held(folder):
        for words in (
            [f"resume={folder}"],
            [*TINY, "overwrite=true"],
            [*TINY, "existing=resume"],
        ):
            with pytest.raises(HeldError, match="a run is training there"):
                run_composed(composed(*words))
    assert contents(folder) == before


def test_a_run_with_other_settings_is_not_taken_for_the_same(folder):
    run_composed(composed(*TINY, "existing=resume", "engine.threads=2"))
    for words, message in (
        (["existing=resume", "engine.renderer=tracer"], r"exists with another engine\.renderer;"),
        (["existing=resume", "steps=128", "algo.gamma=0.5"], "exists with another algo, steps;"),
        ([], "exists; go on with"),
        (["existing=skip"], "existing: 'skip' is unknown; choose from auto, stop, resume"),
    ):
        with pytest.raises(ValueError, match=message):
            run_composed(composed(*TINY, *words))


def test_views_that_no_camera_of_the_run_uses_do_not_count(elsewhere):
    words = [*TINY, "cams=[seg_front]", "image_size=8", "existing=resume"]
    run_composed(composed(*words))
    with pytest.raises(ValueError, match="exists with another views;"):
        run_composed(composed(*words, "views.front.fovy=10"))
    run_composed(composed(*words, "views.side.fovy=10"))


def test_a_run_of_before_a_setting_existed_is_the_same_run(folder, whole):
    """It has the setting's default."""
    path, later = folder / "config.yaml", ("disturb", "label", "task_dir")
    values = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({k: v for k, v in values.items() if k not in later}))
    config = composed(*TINY, "existing=resume", "disturb=mild", "episode.grasp=friction")
    with pytest.raises(ValueError, match="exists with another disturb, episode;"):
        run_composed(config)
    run_composed(composed(*TINY, "existing=resume"))
    assert outcome(folder) == whole


def test_a_checkpoint_that_does_not_fit_is_refused_in_a_line(folder):
    state = torch.load(folder / "checkpoint.pt")
    del state["learner"]["ppo"]["agent"]
    torch.save(state, folder / "checkpoint.pt")
    before = contents(folder)
    with pytest.raises(ValueError, match=r"^checkpoint .*'agent'$"):
        run_composed(composed(f"resume={folder}"))
    # A run that is refused keeps what it has.
    assert {**contents(folder), "manifest.json": before["manifest.json"]} == before
