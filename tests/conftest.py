"""Fixtures that several files share."""

from __future__ import annotations

import hypothesis
import mujoco
import pytest
import torch

from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.robot import joints
from needlehoop.scene.layout import Layout
from needlehoop.scene.spec import build_spec
from needlehoop.task.episode import Episode

# The same examples at every run, however slow and busy the machine.
hypothesis.settings.register_profile(
    "repeatable", derandomize=True, deadline=None, database=None, max_examples=40
)
hypothesis.settings.load_profile("repeatable")

# Batches here are tiny: on a shared machine torch's threads mostly wait for each other.
torch.set_num_threads(1)


@pytest.fixture(scope="session")
def settings() -> Settings:
    return compose_settings()


@pytest.fixture(scope="session")
def layout(settings: Settings) -> Layout:
    return settings.task


@pytest.fixture(scope="session")
def episode(settings: Settings) -> Episode:
    return settings.episode


@pytest.fixture(scope="session", params=joints.VARIANTS)
def model(request: pytest.FixtureRequest, settings: Settings) -> mujoco.MjModel:
    """The compiled scene, with either arm."""
    return build_spec(settings.task, request.param, "weld", settings.views).compile()
