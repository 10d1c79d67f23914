"""Fixtures that several files share."""

from __future__ import annotations

from pathlib import Path

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
