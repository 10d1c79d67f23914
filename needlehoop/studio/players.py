"""Who can act on the page: a person with sliders, scripted controllers, trained policies."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from needlehoop.envs.controllers import (
    Controller,
    MakeController,
    by_name,
    controller,
    controllers,
)
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.learning.evaluate import acting, load_agent
from needlehoop.learning.job import Job
from needlehoop.learning.subject import flown_job
from needlehoop.runs.files import CHECKPOINT, POLICIES
from needlehoop.runs.run import Run
from needlehoop.runs.shipped import agent_of
from needlehoop.tasks.layout import ArmLayout, ToolEpisode

BY_HAND, SHIPPED = "by hand", "shipped agent"

_SENSES = ("cams", "image_size", "quality", "obs", "renderings")
"""Settings that say what a policy sees."""


class Player(NamedTuple):
    make: MakeController
    sees: Mapping[str, Any] = {}
    """What a policy sees, as settings; empty: it needs no images."""


class Hand(NamedTuple):
    """Where a person wants the arm: the tip in m, world frame, and the jaws' angle in rad."""

    tip: tuple[float, float, float]
    jaw: float

    @staticmethod
    def of(memory: Any) -> Hand:
        """Where the arm's targets are, of a simulation's state."""
        x, y, z = memory["target"][0].tolist()
        return Hand((x, y, z), float(memory["jaw"]))

    def act(self, rules: Any, memory: Any) -> Tensor:
        """The action ``(1, action_size)`` that brings the arm's targets nearer to this."""
        action = torch.zeros(1, rules.action_size, dtype=torch.float64)
        tip = torch.tensor([self.tip], dtype=torch.float64)
        action[:, :3] = (tip - memory["target"]) / rules.translation
        action[:, -1] = (self.jaw - memory["jaw"]) / rules.jaw
        return action.clamp(-1.0, 1.0)


def has_sliders(settings: Settings) -> bool:
    """Whether the task's robot is an arm whose tip and jaw can be moved by sliders."""
    return isinstance(settings.task, ArmLayout) and isinstance(settings.episode, ToolEpisode)


def players(
    settings: Settings, run: Path | None, trust: bool, device: torch.device
) -> dict[str, Player]:
    """All that can act in an environment, by name.

    Those of the run in a folder, or without one the task's shipped agent if it fits.
    """
    choices = {}
    for name in controllers(settings):
        # A script for another control mode is left out.
        with suppress(ValueError):
            controller(name, settings)
            choices[name] = Player(by_name(name))
    opened = Run.open(run or agent_of(settings.task.name), "run")
    job, _ = flown_job(opened.config(), (), trust)
    if run is None:
        env = job.env
        fits = env.task.name == settings.task.name
        fits &= env.episode.control == settings.episode.control
        fits &= {camera.view for camera in env.cameras} <= {*settings.views}
        return choices | ({SHIPPED: _policy(opened, job, "last", device)} if fits else {})
    for which, file in POLICIES.items():
        if (run / file).exists() or (which == "last" and (run / CHECKPOINT).exists()):
            choices[f"{which} policy"] = _policy(opened, job, which, device)
    return choices


def _policy(run: Run, job: Job, which: str, device: torch.device) -> Player:
    @cache
    def loaded() -> MakeController:
        return acting(load_agent(run, job, device, which).actor)

    def make(simulation: Simulation) -> Controller:
        return loaded()(simulation)

    return Player(make, {name: getattr(job.env, name) for name in _SENSES})
