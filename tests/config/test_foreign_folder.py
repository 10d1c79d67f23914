"""A config folder that somebody else wrote: bounded files, and no look at the environment."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf
from omegaconf.basecontainer import BaseContainer
from tiny_runs import TINY, refusal

from needlehoop.config import composing

SECRET = "SECRET_OF_THE_TEST"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for group in ("experiment", "task", "view"):
        (tmp_path / "own" / group).mkdir(parents=True)
    return tmp_path / "own"


def fill(file: Path, content: bytes | None) -> None:
    """A file with a content; a pipe that nobody writes to for ``None``."""
    if content is None:
        os.mkfifo(file)
    else:
        file.write_bytes(content)


CONTENTS = {
    "list": (b"[1, 2]", "holds no keys"),
    "binary": (b"\x00\xff\xfe" * 50, "is no text"),
    "pipe": (None, "is no plain file"),
    "large": (b"a: 1\n" + b"#" * 300_000, "is larger than"),
    "aliases": (b"a: &x [1]\nb: *x\n", "has YAML aliases"),
}


@pytest.mark.parametrize("kind", CONTENTS)
def test_a_bad_file_is_named_where_it_is_chosen_and_nowhere_else(folder, kind):
    content, why = CONTENTS[kind]
    for group in ("experiment", "task"):
        fill(folder / group / "bad.yaml", content)
    (folder / "experiment" / "good.yaml").write_text("# @package _global_\nimage_size: 32\n")
    words = [f"conf_dir={folder}"]
    assert composing.compose([*words, "+experiment=good"])["image_size"] == 32
    for choice in ("+experiment=bad", "task=bad"):
        with pytest.raises(ValueError, match=rf"/bad\.yaml {why}"):
            composing.compose([*words, choice])
    assert f"bad.yaml {why}" in refusal("-m", *words, "+experiment=bad", *TINY)


@pytest.mark.parametrize("text", ["hydra: 3\n", "hydra: {sweeper: [1]}\n"])
def test_an_experiment_s_sweep_of_another_shape_is_one_line(folder, text):
    (folder / "experiment" / "odd.yaml").write_text(f"# @package _global_\n{text}")
    assert refusal("-m", f"conf_dir={folder}", "+experiment=odd", *TINY)


@pytest.mark.parametrize(
    "value", [f"${{oc.env:{SECRET}}}", f"${{oc.decode:'${{oc.env:{SECRET}}}'}}", "${${psm}:SECRET}"]
)
def test_a_file_cannot_read_the_environment(folder, value, monkeypatch):
    monkeypatch.setenv(SECRET, "hush")
    (folder / "experiment" / "thief.yaml").write_text(f"# @package _global_\nstudy: {value}\n")
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        composing.compose([f"conf_dir={folder}", "+experiment=thief"], "config")
    assert "hush" not in str(caught.value)
    said = refusal("-m", f"conf_dir={folder}", "+experiment=thief", *TINY)
    assert "hush" not in said
    assert not list(Path().rglob("*hush*"))


def test_a_variable_is_read_where_it_is_typed(monkeypatch):
    monkeypatch.setenv(SECRET, "mine")
    assert composing.compose([f"study=${{oc.env:{SECRET}}}"], "config")["study"] == "mine"
    assert composing.compose(["study=${oc.env:NOT_THERE,other}"], "config")["study"] == "other"
    composing.compose([])
    with pytest.raises(ValueError, match="only where you type them"):
        composing._variable(SECRET)


def test_a_host_s_own_use_of_hydra_stays_as_it_was(monkeypatch):
    monkeypatch.setenv(SECRET, "theirs")
    store = ConfigStore.instance()
    store.store(group="cams", name="theirs", node={"kind": "webcam"})
    try:
        composing.compose(["cams=[dep_front]"])
        assert store.load("cams/theirs.yaml").node == {"kind": "webcam"}
        assert OmegaConf.create({"key": f"${{oc.env:{SECRET}}}"}).key == "theirs"
    finally:
        del store.repo["cams"]["theirs.yaml"]


def test_no_other_resolver_of_omegaconf_reads_the_machine():
    """A resolver that a new version brings is looked at before it is added here."""
    theirs = {name for name in BaseContainer._resolvers if name.startswith("oc.") or name == "env"}
    harmless = {"oc.create", "oc.decode", "oc.deprecated", "oc.dict.keys", "oc.dict.values"}
    assert theirs == {*harmless, "oc.select", "oc.env"}


@pytest.mark.parametrize("key", ["conf_dir", "task_dir"])
def test_a_folder_s_name_that_is_too_long_for_a_disk_is_no_folder(key):
    with pytest.raises(ValueError, match=rf"^{key}: '.*9(/conf)?' is no folder$"):
        composing.compose([f"{key}={'9' * 300}"])
