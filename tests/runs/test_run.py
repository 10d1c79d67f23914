"""The files of a run, and what is left of them when its process ends badly."""

import json
import math
import os
from pathlib import Path

import pytest
import torch

from needlehoop import config
from needlehoop.engines.contract import EngineConfig
from needlehoop.runs.files import CHECKPOINT, CONFIG, MANIFEST, METRICS, REWARD
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
    assert manifest["steps"] == 0
    assert {"commit", "python", "started"} <= manifest.keys()


@pytest.mark.parametrize(
    ("engine", "renderer"),
    [({"threads": 0}, "tracer"), ({"threads": 0, "renderer": "rasteriser"}, "rasteriser")],
)
def test_a_run_older_than_the_choice_of_a_renderer_goes_on_with_the_tracer(
    folder, engine, renderer
):
    # A whole config, so that what evaluates and resumes can read it.
    values = {**config.compose(["cams=seg_side"], "config"), "engine": engine}
    Run.create(folder, values, "", overwrite=False)
    read = config.job(Run.open(folder).config())
    assert read.env.engine == EngineConfig(threads=0, renderer=renderer)


def test_a_run_may_begin_in_an_empty_folder(folder):
    folder.mkdir(parents=True)
    assert Run.create(folder, VALUES, "", overwrite=False).config() == VALUES


def test_an_existing_run_is_not_begun_again_unasked(run, folder):
    fill(run, 1, 2)
    with pytest.raises(ValueError, match=r"exists.*resume=.*overwrite=true") as caught:
        Run.create(folder, {"study": "other"}, "other", overwrite=False)
    assert f"resume={folder}" in str(caught.value)
    assert run.config() == VALUES
    assert updates_of(run) == [1, 2]


def test_overwrite_replaces_a_run_and_all_its_files(run, folder):
    fill(run, 1)
    run.save({"update": 1})
    (folder / "wandb").mkdir()
    replaced = Run.create(folder, {"study": "other"}, "other", overwrite=True)
    assert replaced.config() == {"study": "other"}
    assert {path.name for path in folder.iterdir()} == {CONFIG, MANIFEST, REWARD}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_with_somebody_elses_files_is_never_deleted(folder, overwrite):
    (folder / "thesis").mkdir(parents=True)
    (folder / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(ValueError, match=f"{folder}"):
        Run.create(folder, VALUES, "", overwrite=overwrite)
    assert (folder / "thesis" / "chapter1.tex").read_text() == "years of work"
    assert [path.name for path in folder.iterdir()] == ["thesis"]


def test_overwrite_makes_a_run_where_there_is_none(folder):
    assert Run.create(folder, VALUES, "", overwrite=True).config() == VALUES


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


def test_rows_come_back_in_order_under_one_header(run):
    path = fill(run, 1, 2, 3)
    assert run.rows(METRICS) == [
        {"update": "1", "return": "0.1"},
        {"update": "2", "return": "0.2"},
        {"update": "3", "return": "0.3"},
    ]
    assert path.read_text().splitlines() == ["update,return", "1,0.1", "2,0.2", "3,0.3"]


def test_a_table_that_was_not_begun_has_no_rows(run):
    assert run.rows(METRICS) == []


def test_what_is_not_known_becomes_an_empty_cell(run):
    run.append(METRICS, {"update": 1, "return": math.nan, "success": None, "length": 0.0})
    assert run.rows(METRICS) == [{"update": "1", "return": "", "success": "", "length": "0"}]
    (missing,) = columns(run.rows(METRICS), "return")
    assert math.isnan(missing)


def test_a_row_may_end_with_an_empty_cell(run):
    run.append(METRICS, {"update": 1, "return": 0.5})
    run.append(METRICS, {"update": 2, "return": math.nan})
    assert run.rows(METRICS)[1] == {"update": "2", "return": ""}


def test_a_float32_comes_back_to_the_bit(run):
    generator = torch.Generator().manual_seed(0)
    numbers = torch.randn(200, generator=generator) * 10 ** torch.linspace(-30, 30, 200)
    for number in numbers:
        run.append(METRICS, {"value": float(number)})
    read = torch.tensor(columns(run.rows(METRICS), "value"), dtype=torch.float32)
    assert torch.equal(read, numbers)


@pytest.mark.parametrize("row", [{"update": 2}, {"return": 0.2, "update": 2}])
def test_a_row_with_other_columns_is_refused(run, row):
    path = fill(run, 1)
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match=r"columns \['update', 'return'\]"):
        run.append(METRICS, row)
    assert path.read_bytes() == before


@pytest.mark.parametrize("torn", ["3", "3,", "3,0.", "3,0.3"])
def test_a_torn_row_is_left_out(run, torn):
    path = fill(run, 1, 2)
    with path.open("a") as file:
        file.write(torn)
    assert updates_of(run) == [1, 2]


def test_a_torn_row_does_not_spoil_those_that_follow_a_cut(run):
    path = fill(run, 1, 2)
    with path.open("a") as file:
        file.write("3,0.")
    run.cut(METRICS, 2)
    fill(run, 3)
    assert run.rows(METRICS) == [
        {"update": "1", "return": "0.1"},
        {"update": "2", "return": "0.2"},
        {"update": "3", "return": "0.3"},
    ]


def test_a_table_torn_in_its_header_is_begun_again_after_a_cut(run):
    path = run.folder / METRICS
    path.write_text("update,ret")
    assert run.rows(METRICS) == []
    run.cut(METRICS, 5)
    fill(run, 1)
    assert run.rows(METRICS) == [{"update": "1", "return": "0.1"}]


def test_a_cut_drops_later_rows_and_keeps_the_others_to_the_byte(run):
    path = fill(run, 1, 2)
    kept = path.read_bytes()
    fill(run, 3, 4)
    run.cut(METRICS, 2)
    assert path.read_bytes() == kept
    run.cut(METRICS, 0)
    assert run.rows(METRICS) == []
    run.cut(METRICS, 0)


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
    loaded = Run.open(run.folder).load()
    for name, value in state["weights"].items():
        assert loaded["weights"][name].dtype == value.dtype
        assert torch.equal(loaded["weights"][name], value)
    assert torch.equal(loaded["count"], state["count"])
    assert torch.equal(loaded["rng"], state["rng"])
    plain = ("update", "wall_time", "nothing", "groups")
    assert {key: loaded[key] for key in plain} == {key: state[key] for key in plain}


def test_a_later_checkpoint_replaces_the_earlier(run):
    run.save({"update": 1})
    run.save({"update": 2})
    assert run.load() == {"update": 2}


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
    assert run.load()["update"] == 1
    assert torch.equal(run.load()["weights"], torch.ones(3))
    assert run.manifest()["steps"] == 0
    assert [path.name for path in run.folder.iterdir() if path.suffix == ".partial"] == []


def test_a_run_without_a_checkpoint_says_so(run):
    with pytest.raises(ValueError, match=r"has no checkpoint\.pt.*overwrite=true"):
        run.load()


@pytest.mark.parametrize(
    "content", [b"", b"\x93\xff\x00 noise", b"PK\x03\x04 and no more", b"a,b\n1,2\n"]
)
def test_a_damaged_file_is_named_where_a_run_goes_on(run, content):
    fill(run, 1)
    for name in (CONFIG, MANIFEST, METRICS, CHECKPOINT):
        (run.folder / name).write_bytes(content)
    reads = {
        CONFIG: run.config,
        MANIFEST: run.manifest,
        CHECKPOINT: run.load,
        METRICS: lambda: run.cut(METRICS, 1),
    }
    # A table that was torn off in its header is begun again.
    if b"\n" not in content:
        del reads[METRICS]
    for name, read in reads.items():
        with pytest.raises(ValueError, match=f"{name} is damaged.*overwrite=true"):
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
        run.load()
    assert not sprung.exists()
    torch.load(run.folder / CHECKPOINT, weights_only=False)
    assert sprung.exists()


def test_a_small_file_is_written_where_it_is_said(run):
    path = run.write("evaluation.json", "{}\n")
    assert path == run.folder / "evaluation.json"
    assert path.read_text() == "{}\n"
