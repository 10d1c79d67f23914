"""The files of a run, and what is left of them when its process ends badly."""

import json
import math
import os
from pathlib import Path

import pytest
import torch
from tiny_runs import contents

from needlehoop.runs.files import CHECKPOINT, CONFIG, MANIFEST, METRICS, REWARD, new_folder
from needlehoop.runs.run import Run

VALUES = {"study": "main", "cams": ["seg_side"], "algo": {"gamma": 0.99}, "resume": None}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "study" / "seg_side" / "human" / "seed0"


@pytest.fixture
def run(folder: Path) -> Run:
    return Run.create(folder, VALUES, "grasp: 2.0\n", overwrite=False)


def fill(run: Run, *updates: int) -> Path:
    for update in updates:
        run.append(METRICS, {"update": update, "return": update / 10})
    return run.folder / METRICS


def updates_of(run: Run) -> list[int]:
    return [int(row["update"]) for row in run.rows(METRICS)]


def test_a_new_run_writes_down_what_it_is(run, folder):
    assert {path.name for path in folder.iterdir()} == {CONFIG, MANIFEST, REWARD}
    assert (folder / REWARD).read_text() == "grasp: 2.0\n"
    assert Run.open(folder).config() == VALUES
    manifest = json.loads((folder / MANIFEST).read_text())
    assert manifest == run.manifest()
    assert manifest["versions"]["torch"] == torch.__version__
    assert manifest["finished"] is False
    assert {"commit", "python", "started"} <= manifest.keys()
    run.note(steps=512, finished=True)
    assert run.manifest() == {**manifest, "steps": 512, "finished": True}
    with pytest.raises(ValueError, match=r"has no checkpoint\.pt.*nothing can go on from there"):
        run.checkpoint()


def test_an_existing_run_is_not_begun_again_unasked(run, folder):
    fill(run, 1, 2)
    with pytest.raises(ValueError, match=f"exists.*resume={folder}.*overwrite=true"):
        Run.create(folder, {"study": "other"}, "other", overwrite=False)
    assert Run.open(folder).config() == VALUES
    assert updates_of(run) == [1, 2]


def test_overwrite_begins_anew_and_keeps_what_was_there_under_a_number(run, folder):
    fill(run, 1)
    run.save({"update": 1})
    (folder / "thesis.tex").write_text("years of work")
    before = contents(folder)
    for number in (1, 2):
        replaced = Run.create(folder, {"study": number}, "other", overwrite=True)
        assert replaced.config() == {"study": number}
        assert {path.name for path in folder.iterdir()} == {CONFIG, MANIFEST, REWARD}
    kept = folder.parent / "seed0.1"
    assert contents(kept) == before
    # A run that has written nothing goes, and the one that it replaced comes back.
    replaced.unmake()
    assert Run.open(folder).config() == {"study": 1}
    assert {path.name for path in folder.parent.iterdir()} == {"seed0", "seed0.1"}


@pytest.mark.parametrize("name", [REWARD, MANIFEST])
def test_a_run_is_born_whole_or_not_at_all(folder, monkeypatch, name):
    real = Path.open

    def full(path, *args, **named):
        if path.name.startswith(name):
            raise OSError(28, "No space left on device", str(path))
        return real(path, *args, **named)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", full)
        with pytest.raises(OSError, match=f"No space left on device.*{name}"):
            Run.create(folder, VALUES, "", overwrite=False)
    assert not folder.exists()
    assert Run.create(folder, VALUES, "", overwrite=False).config() == VALUES
    assert [path.name for path in folder.parent.iterdir()] == ["seed0"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_with_somebody_elses_files_is_never_deleted(folder, overwrite):
    (folder / "thesis").mkdir(parents=True)
    (folder / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(ValueError, match=f"{folder}"):
        Run.create(folder, VALUES, "", overwrite=overwrite)
    assert (folder / "thesis" / "chapter1.tex").read_text() == "years of work"
    assert [path.name for path in folder.iterdir()] == ["thesis"]


def test_what_is_not_known_becomes_an_empty_cell(run):
    run.append(METRICS, {"update": 1, "return": math.nan, "success": None, "length": 0.0})
    assert run.rows(METRICS) == [{"update": "1", "return": "", "success": "", "length": "0"}]


def test_a_float32_comes_back_to_the_bit(run):
    generator = torch.Generator().manual_seed(0)
    numbers = torch.randn(200, generator=generator) * 10 ** torch.linspace(-30, 30, 200)
    for number in numbers:
        run.append(METRICS, {"value": float(number)})
    read = [float(row["value"]) for row in run.rows(METRICS)]
    assert torch.equal(torch.tensor(read, dtype=torch.float32), numbers)


def test_a_table_keeps_the_columns_that_it_began_with(run):
    path = fill(run, 1)
    run.append(METRICS, {"newer": 1.0, "return": 0.5, "update": 2})
    assert path.read_text() == "update,return\n1,0.1\n2,0.5\n"
    with pytest.raises(RuntimeError, match="the row lacks return"):
        run.append(METRICS, {"update": 2})
    assert path.read_text() == "update,return\n1,0.1\n2,0.5\n"


@pytest.mark.parametrize("torn", ["3,", "3,0.3\n4,0.4\n"])
def test_rows_after_the_checkpoint_are_made_again(run, folder, torn):
    path = fill(run, 1)
    run.save({"update": 1})
    fill(run, 2)
    with path.open("a") as file:
        file.write(torn)
    again = Run.open(folder)
    again.go_on(again.checkpoint())
    fill(again, 2, 3)
    assert path.read_text() == "update,return\n1,0.1\n2,0.2\n3,0.3\n"
    again.go_on(None)
    fill(again, 1)
    assert path.read_text() == "update,return\n1,0.1\n"


def test_a_table_that_lost_rows_is_named(run):
    path = fill(run, 1, 2)
    run.save({"update": 2})
    os.truncate(path, 20)
    with pytest.raises(ValueError, match=r"metrics\.csv has lost rows"):
        run.go_on(run.checkpoint())


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more"])
def test_a_damaged_file_is_named_where_a_run_goes_on(run, content):
    run.save({"update": 0})
    for name in (CONFIG, MANIFEST, CHECKPOINT):
        (run.folder / name).write_bytes(content)
    again = Run.open(run.folder)
    for name, read in (
        (CONFIG, again.config),
        (MANIFEST, again.manifest),
        (CHECKPOINT, again.checkpoint),
    ):
        with pytest.raises(ValueError, match=rf"{name} is "):
            read()


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


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    out = tmp_path / "export"
    # What a killed process left.
    (tmp_path / "export.partial").mkdir()
    with new_folder(out, overwrite=False) as made:
        (made / "content").write_text("old")
    with pytest.raises(ValueError, match="exists"), new_folder(out, overwrite=False):
        pass
    with pytest.raises(OSError, match="disk"), new_folder(out, overwrite=True) as made:
        raise OSError("disk")
    assert (out / "content").read_text() == "old"
    with new_folder(out, overwrite=True) as made:
        (made / "content").write_text("new")
    assert (out / "content").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["export"]
