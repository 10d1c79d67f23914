"""Fixtures that several files share."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import mujoco
import pytest
import torch
from needle_task import spec_of
from strength import ALL
from tiny_runs import PLACE, TINY, composed, run_composed

from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.robot import psm
from needlehoop.tasks.needle_hoop.scene import NeedleLayout, NeedleRules

# The same examples at every run, however slow and busy the machine.
hypothesis.settings.register_profile(
    "repeatable", derandomize=True, deadline=None, database=None, max_examples=40
)
hypothesis.settings.load_profile("repeatable")

# Batches here are tiny: on a shared machine torch's threads mostly wait for each other.
torch.set_num_threads(1)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the cases marked ``full`` to ``make test-all``."""
    if not ALL:
        config.hook.pytest_deselected(
            items=[one for one in items if one.get_closest_marker("full")]
        )
        items[:] = [one for one in items if not one.get_closest_marker("full")]


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run of ``TINY``; tests copy it before they change it."""
    results = tmp_path_factory.mktemp("tiny")
    run_composed(composed(*TINY, f"results={results}"))
    return results / PLACE


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Debian's Chromium, through its own driver; it logs what pages say and ask for."""
    # Slow to import.
    from selenium import webdriver

    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("no chromium and chromedriver here: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    flags = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1600,1000"]
    flags += ["--no-first-run", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    for flag in (*flags, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield chrome
    chrome.quit()


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def settings() -> Settings:
    return compose_settings()


@pytest.fixture(scope="session")
def layout(settings: Settings) -> NeedleLayout:
    return settings.task


@pytest.fixture(scope="session")
def episode(settings: Settings) -> NeedleRules:
    return settings.episode


@pytest.fixture(scope="session", params=psm.VARIANTS)
def model(request: pytest.FixtureRequest, settings: Settings) -> mujoco.MjModel:
    """The compiled scene, with either arm."""
    return spec_of(settings, request.param).compile()
