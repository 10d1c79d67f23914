"""The files of a run, and what is left of them when its process ends badly."""

import csv
import itertools
import json
import math
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from needlehoop.runs.files import (
    CHECKPOINT,
    CONFIG,
    MANIFEST,
    METRICS,
    REWARD,
    new_folder,
    write_whole,
)
from needlehoop.runs.run import Run

CPU = torch.device("cpu")
VALUES = {"study": "main", "cams": ["seg_side"], "algo": {"gamma": 0.99}, "resume": None}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "study" / "seg_side" / "human" / "seed0"


@pytest.fixture
def run(folder: Path) -> Run:
    return Run.create(folder, VALUES, "grasp: 2.0\n", overwrite=False)


def columns(rows: list[dict[str, str]], name: str) -> list[float]:
    return [float(row[name]) if row[name] else math.nan for row in rows]


def table(*updates: int) -> list[dict[str, float]]:
    return [{"update": update, "return": update / 10} for update in updates]


def fill(run: Run, *updates: int) -> Path:
    for row in table(*updates):
        run.append(METRICS, row)
    return run.folder / METRICS


def rows_of(run: Run) -> list[dict[str, str]]:
    with (run.folder / METRICS).open(newline="") as file:
        return list(csv.DictReader(file))


def updates_of(run: Run) -> list[int]:
    return [int(row["update"]) for row in rows_of(run)]


def save(run: Run, update: int = 0) -> None:
    run.save({"update": update})


def go_on(folder: Path) -> Run:
    """The run in another process, as far as its files go, with its next row."""
    run = Run.open(folder)
    checkpoint = run.checkpoint()
    run.go_on(checkpoint)
    fill(run, checkpoint.state["update"] + 1)
    return run


def test_a_new_run_writes_down_what_it_is(run, folder):
    assert {path.name for path in folder.iterdir()} == {CONFIG, MANIFEST, REWARD}
    assert (folder / REWARD).read_text() == "grasp: 2.0\n"
    assert Run.open(folder).config() == VALUES
    manifest = json.loads((folder / MANIFEST).read_text())
    assert manifest == run.manifest()
    assert manifest["versions"]["torch"] == torch.__version__
    assert manifest["finished"] is False
    assert manifest["steps"] == 0
    assert {"commit", "python", "started"} <= manifest.keys()


def test_an_existing_run_is_not_begun_again_unasked(run, folder):
    fill(run, 1, 2)
    with pytest.raises(ValueError, match=r"exists.*resume=.*overwrite=true") as caught:
        Run.create(folder, {"study": "other"}, "other", overwrite=False)
    assert f"resume={folder}" in str(caught.value)
    assert run.config() == VALUES
    assert updates_of(run) == [1, 2]


def test_overwrite_begins_anew_and_keeps_what_was_there_under_a_number(run, folder):
    fill(run, 1)
    save(run, 1)
    (folder / "thesis.tex").write_text("years of work")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    for number in (1, 2):
        replaced = Run.create(folder, {"study": number}, "other", overwrite=True)
        assert replaced.config() == {"study": number}
        assert {path.name for path in folder.iterdir()} == {CONFIG, MANIFEST, REWARD}
    kept = folder.parent / "seed0.1"
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before
    assert {path.name for path in folder.parent.iterdir()} == {"seed0", "seed0.1", "seed0.2"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_run_begins_where_nothing_is_or_one_died_in_the_making(folder, overwrite):
    folder.mkdir(parents=True)
    (folder.parent / ".seed0.new").mkdir()
    (folder.parent / ".seed0.new" / REWARD).write_text("half a run")
    assert Run.create(folder, VALUES, "", overwrite).config() == VALUES
    assert [path.name for path in folder.parent.iterdir()] == ["seed0"]


@pytest.mark.parametrize("name", [REWARD, MANIFEST, CONFIG])
def test_a_run_is_born_whole_or_not_at_all(folder, monkeypatch, name):
    def full(path, content):
        if path.name == name:
            raise OSError(28, "No space left on device", str(path))
        write_whole(path, content)

    with monkeypatch.context() as patched:
        patched.setattr("needlehoop.runs.run.write_whole", full)
        with pytest.raises(OSError, match=f"No space left on device.*{name}"):
            Run.create(folder, VALUES, "", overwrite=False)
    assert list(folder.parent.iterdir()) == []
    assert Run.create(folder, VALUES, "", overwrite=False).config() == VALUES


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_with_somebody_elses_files_is_never_deleted(folder, overwrite):
    (folder / "thesis").mkdir(parents=True)
    (folder / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(ValueError, match=f"{folder}"):
        Run.create(folder, VALUES, "", overwrite=overwrite)
    assert (folder / "thesis" / "chapter1.tex").read_text() == "years of work"
    assert [path.name for path in folder.iterdir()] == ["thesis"]


def test_a_folder_without_a_config_is_no_run(tmp_path):
    (tmp_path / METRICS).write_text("update\r\n1\r\n")
    for place in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ValueError, match=r"is no run: it has no config\.yaml"):
            Run.open(place)


def test_notes_add_to_the_manifest_and_replace_what_they_name(run):
    before = run.manifest()
    run.note(steps=512, finished=True)
    run.note(wall_time=1.5)
    assert run.manifest() == {**before, "steps": 512, "finished": True, "wall_time": 1.5}


def test_what_is_not_known_becomes_an_empty_cell(run):
    run.append(METRICS, {"update": 1, "return": math.nan, "success": None, "length": 0.0})
    assert rows_of(run) == [{"update": "1", "return": "", "success": "", "length": "0"}]
    (missing,) = columns(rows_of(run), "return")
    assert math.isnan(missing)


def test_a_float32_comes_back_to_the_bit(run):
    generator = torch.Generator().manual_seed(0)
    numbers = torch.randn(200, generator=generator) * 10 ** torch.linspace(-30, 30, 200)
    for number in numbers:
        run.append(METRICS, {"value": float(number)})
    read = torch.tensor(columns(rows_of(run), "value"), dtype=torch.float32)
    assert torch.equal(read, numbers)


def test_a_row_that_lacks_a_column_is_refused(run):
    path = fill(run, 1)
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match=r"columns \['update', 'return'\]"):
        run.append(METRICS, {"update": 2})
    assert path.read_bytes() == before


def test_a_table_keeps_the_columns_that_it_began_with(run):
    path = fill(run, 1)
    run.append(METRICS, {"newer": 1.0, "return": 0.5, "update": 2})
    head, *_, last = path.read_text().splitlines()
    assert (head, last) == ("update,return", "2,0.5")


@pytest.mark.parametrize("torn", ["3,", "3,0.3", "3,0.3\n4,0.4\n"])
def test_rows_after_the_checkpoint_are_made_again(run, folder, torn, capsys):
    path = fill(run, 1, 2)
    save(run, 2)
    with path.open("a") as file:
        file.write(torn)
    go_on(folder)
    assert path.read_text() == "update,return\n1,0.1\n2,0.2\n3,0.3\n"
    assert capsys.readouterr().err == ""


DAMAGED = {
    "lost": None,
    "emptied": b"",
    "rows gone": b"update,return\n2,0.2\n",
    "edited": b"update,return\n1,0.1\n2,0.9\n3,0.3\n",
    "noise": b"\xff\xfe\x00",
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_table_is_made_whole_from_the_checkpoint(run, folder, content, capsys):
    path = fill(run, 1, 2, 3)
    save(run, 3)
    path.unlink() if content is None else path.write_bytes(content)
    go_on(folder)
    assert path.read_text() == "update,return\n1,0.1\n2,0.2\n3,0.3\n4,0.4\n"
    said = capsys.readouterr().err
    assert f"{path} was damaged, and is whole again" in said
    if content:
        assert "kept as metrics.1.csv" in said
        assert (folder / "metrics.1.csv").read_bytes() == content


def test_a_table_that_is_emptied_under_a_running_run_is_made_whole_at_the_checkpoint(run, capsys):
    path = fill(run, 1, 2)
    os.truncate(path, 0)
    fill(run, 3)
    save(run, 3)
    assert updates_of(run) == [1, 2, 3]
    assert "was damaged, and is whole again" in capsys.readouterr().err


def test_a_refused_run_keeps_its_rows(run, folder):
    """Only the next row cuts: whoever finds the checkpoint unfit before that has lost nothing."""
    path = fill(run, 1, 2, 3)
    save(run, 1)
    before = path.read_bytes()
    again = Run.open(folder)
    again.go_on(again.checkpoint())
    assert path.read_bytes() == before


def test_a_checkpoint_comes_back_as_it_was_saved(run):
    state = {
        "weights": {"a": torch.randn(3, 4), "flags": torch.tensor([True, False])},
        "count": torch.tensor(7, dtype=torch.float64),
        "rng": torch.get_rng_state(),
        "update": 12,
        "wall_time": 3.25,
        "nothing": None,
        "groups": [{"lr": 1e-3, "betas": (0.9, 0.999)}],
    }
    run.save(state)
    loaded = Run.open(run.folder).checkpoint().state
    for name, value in state["weights"].items():
        assert loaded["weights"][name].dtype == value.dtype
        assert torch.equal(loaded["weights"][name], value)
    assert torch.equal(loaded["count"], state["count"])
    assert torch.equal(loaded["rng"], state["rng"])
    plain = ("update", "wall_time", "nothing", "groups")
    assert {key: loaded[key] for key in plain} == {key: state[key] for key in plain}


def test_a_full_disk_leaves_the_previous_checkpoint(run, monkeypatch):
    run.save({"update": 1, "weights": torch.ones(3)})

    def full(descriptor):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            run.save({"update": 2, "weights": torch.zeros(3)})
        with pytest.raises(OSError, match="No space left"):
            run.note(steps=1)
    assert run.checkpoint().state["update"] == 1
    assert torch.equal(run.checkpoint().state["weights"], torch.ones(3))
    assert run.manifest()["steps"] == 0
    assert [path.name for path in run.folder.iterdir() if path.suffix == ".partial"] == []


def test_a_run_without_a_checkpoint_says_so(run):
    with pytest.raises(ValueError, match=r"has no checkpoint\.pt.*nothing can go on from there"):
        run.checkpoint()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more", b"a,b\n1,2\n"])
def test_a_damaged_file_is_named_where_a_run_goes_on(run, content):
    save(run)
    for name in (CONFIG, MANIFEST, CHECKPOINT):
        (run.folder / name).write_bytes(content)
    again = Run.open(run.folder)
    for name, read in (
        (CONFIG, again.config),
        (MANIFEST, again.manifest),
        (CHECKPOINT, again.checkpoint),
    ):
        with pytest.raises(ValueError, match=rf"{name} (is|holds) .*; put it back.*overwrite=true"):
            read()


def test_no_flipped_bit_is_trained_on(run):
    state = {"update": 3, "weights": torch.arange(50.0), "groups": [{"lr": 0.1, "on": None}]}
    run.save(state)
    path = run.folder / CHECKPOINT
    whole = path.read_bytes()
    refused = 0
    for place in range(0, len(whole), 29):
        flipped = bytes([whole[place] ^ (1 << place % 8)])
        path.write_bytes(whole[:place] + flipped + whole[place + 1 :])
        try:
            found = run.checkpoint().state
        except ValueError:
            refused += 1
            continue
        assert repr(found) == repr(state)
    # The rest is padding, and what a reader does not look at.
    assert refused > len(whole) // 29 / 3


def test_a_checkpoint_that_is_no_plain_file_is_refused(run):
    os.mkfifo(run.folder / CHECKPOINT)
    with pytest.raises(ValueError, match=r"checkpoint\.pt is no plain file"):
        run.checkpoint()


class Trap:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_checkpoint_from_elsewhere_runs_no_code(run, tmp_path):
    sprung = tmp_path / "sprung"
    torch.save({"update": 1, "trap": Trap(sprung)}, run.folder / CHECKPOINT)
    with pytest.raises(ValueError, match=r"checkpoint\.pt is damaged"):
        run.checkpoint()
    assert not sprung.exists()
    torch.load(run.folder / CHECKPOINT, weights_only=False)
    assert sprung.exists()


@pytest.mark.parametrize("moment", ["old aside", "new in place", "old gone"])
def test_a_kill_while_a_folder_is_replaced_loses_neither(tmp_path, moment):
    """At every step of the exchange: the old one or the new one is there at the next call."""
    out = tmp_path / "export"
    with new_folder(out, overwrite=False) as made:
        (made / "content").write_text("old")
    calls = {"old aside": ("rename", 1), "new in place": ("rename", 2), "old gone": ("rmtree", 3)}
    name, number = calls[moment]
    child = os.fork()
    if child == 0:
        _die_at(name, number)
        with new_folder(out, overwrite=True) as made:
            (made / "content").write_text("new")
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    with pytest.raises(ValueError, match="exists"), new_folder(out, overwrite=False):
        pass
    assert (out / "content").read_text() == ("old" if moment != "old gone" else "new")
    with new_folder(out, overwrite=True) as made:
        (made / "content").write_text("newer")
    assert [path.name for path in tmp_path.iterdir()] == ["export"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_the_users_beside_an_export_stays(tmp_path, overwrite):
    (tmp_path / "export.old").mkdir()
    (tmp_path / "export.old" / "thesis.tex").write_text("years of work")
    for again in (False, overwrite):
        if not again:
            shutil.rmtree(tmp_path / "export", ignore_errors=True)
        with new_folder(tmp_path / "export", overwrite=again):
            pass
    assert (tmp_path / "export.old" / "thesis.tex").read_text() == "years of work"


def _die_at(name: str, number: int) -> None:
    """Kill this process before the so-many-th call of a file operation."""
    place: Any = Path if name == "rename" else shutil
    real, calls = getattr(place, name), itertools.count(1)

    def dying(*args: Any, **kwargs: Any) -> Any:
        if next(calls) == number:
            os._exit(9)
        return real(*args, **kwargs)

    setattr(place, name, dying)
