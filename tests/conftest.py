"""Fixtures that several files share."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import mujoco
import pytest
import torch
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import OverrideType
from needle_task import spec_of
from omegaconf import DictConfig
from strength import ALL
from tiny_runs import PLACE, TINY, composed, run_composed

from needlehoop.config import composing
from needlehoop.config.changing import RECORDED
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


@pytest.fixture(scope="session", autouse=True)
def read_configs_once() -> Iterator[Callable[..., DictConfig]]:
    """Read the files of a choice of options once per session; Hydra sets the other words anew.

    Yields:
        Hydra's own function, which reads the files at every call.
    """
    real, known = composing.hydra_compose, {}
    parser = OverridesParser.create()
    groups = {"cams", *(path.name for path in composing.CONF.iterdir() if path.is_dir())}

    def compose(name: str, overrides: list[str] | None = None, **more: Any) -> DictConfig:
        words = parser.parse_overrides(list(overrides or ()))
        # Additions, deletions and Hydra's own keys change more than the value of a key; what a run
        # recorded is another config for each run.
        if (
            name == RECORDED
            or more
            or any(
                word.is_sweep_override()
                or word.type is not OverrideType.CHANGE
                or word.package
                or word.key_or_group.startswith("hydra")
                for word in words
            )
        ):
            return real(name, overrides=overrides, **more)
        searched = GlobalHydra.instance().config_loader().get_search_path().get_path()
        choices = [word.input_line for word in words if word.key_or_group in groups]
        key = (name, *(place.path for place in searched), *choices)
        if key not in known:
            known[key] = real(name, overrides=choices)
        composed = copy.deepcopy(known[key])
        rest = [word for word in words if word.key_or_group not in groups]
        ConfigLoaderImpl._apply_overrides_to_config(rest, composed)
        return composed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(composing, "hydra_compose", compose)
        yield real


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run of ``TINY``; tests copy it before they change it."""
    results = tmp_path_factory.mktemp("tiny")
    run_composed(composed(*TINY, f"results={results}"))
    return results / PLACE


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
