"""Configs that lack what is newer than they are."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from needlehoop.config import composing
from needlehoop.learning.job import typed_job
from needlehoop.runs.files import reward_name
from needlehoop.runs.older import completed
from needlehoop.runs.run import Run

RESULTS = Path(__file__).parents[2] / "results"
KEPT = [path.parent for path in sorted(RESULTS.glob("*/*/*/seed*/config.yaml"))]


@pytest.mark.parametrize("folder", KEPT, ids=lambda one: str(one.relative_to(RESULTS)))
def test_every_run_that_is_kept_is_read(folder):
    job = typed_job(Run.open(folder).config())
    assert job.place.endswith(str(folder.relative_to(RESULTS / folder.parts[-4])))


def test_todays_config_lacks_nothing():
    for words in (["cams=[seg_side]"], ["cams=[seg_side]", "algo=dagger"], ["obs=signals"]):
        values = composing.compose(words, "config")
        assert completed(values) == values


def test_what_is_not_there_to_be_completed_is_left_alone():
    assert completed({}) == {}
    assert completed({"engine": 5, "reward": [1]}) == {"engine": 5, "reward": [1]}
    before = {"algo": {"network": {}}}
    found = completed(before)
    assert found["algo"]["network"] == {"told": []}
    assert found["algo"]["warmup"] == 0
    assert before == {"algo": {"network": {}}}


def test_an_older_run_was_told_nothing():
    before = {"obs": {"proprio": False}}
    assert completed(before) == {"obs": {"proprio": False, "told": []}}


def test_an_older_run_drew_with_rays():
    values = yaml.safe_load(next((RESULTS / "former").rglob("config.yaml")).read_text())
    assert "renderer" not in values["engine"]
    assert completed(values)["engine"]["renderer"] == "tracer"


@pytest.mark.parametrize("option", ["human", "sparse", "vlm_text", "vlm_img"])
def test_an_older_run_called_its_reward_by_its_kind(option):
    values = composing.compose(["cams=[dep_front,seg_side]", f"reward={option}"], "config")
    del values["reward"]["name"]
    assert reward_name(values["reward"]) == option
    assert completed(values)["reward"]["name"] is None
    assert reward_name(completed(values)["reward"]) == option
