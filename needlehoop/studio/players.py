"""Who can act on the page: a person with sliders, scripted controllers, trained policies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.envs.controllers import Controller, MakeController, by_name, controllers
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


class Player(NamedTuple):
    """Someone who acts."""

    make: MakeController
    sees: Settings | None = None
    """The environment that a policy was trained in; ``None``: it needs no images."""


@dataclass(frozen=True)
class Hand:
    """Where a person wants the arm: the tip in m, world frame, and the jaws' angle in rad."""

    tip: tuple[float, float, float]
    jaw: float

    def act(self, simulation: Simulation) -> Tensor:
        """The action ``(1, action_size)`` that brings the arm's targets nearer to this."""
        rules, memory = simulation.episode, simulation.state
        assert isinstance(rules, ToolEpisode)
        assert memory is not None
        action = torch.zeros(1, rules.action_size, dtype=torch.float64)
        tip = torch.tensor([self.tip], dtype=torch.float64)
        action[:, :3] = (tip - memory["target"]) / rules.translation
        action[:, -1] = (self.jaw - memory["jaw"]) / rules.jaw
        return action.clamp(-1.0, 1.0)


def has_sliders(settings: Settings) -> bool:
    """Whether the task's robot is an arm whose tip and jaw can be moved by sliders."""
    return isinstance(settings.task, ArmLayout) and isinstance(settings.episode, ToolEpisode)


def hand_of(simulation: Simulation) -> Hand:
    """Where the arm's targets are now."""
    memory = simulation.state
    assert memory is not None
    x, y, z = memory["target"][0].tolist()
    return Hand((x, y, z), float(memory["jaw"]))


def players(
    settings: Settings, run: Path | None, trust: bool, device: torch.device
) -> dict[str, Player]:
    """All that can act in an environment, by name; ``run`` is a run's folder.

    Without a run, the task's shipped agent is among them, if there is one.
    """
    found = {name: Player(by_name(name)) for name in controllers(settings)}
    if run is None:
        folder = agent_of(settings.task.name)
        job, _ = flown_job(Run.open(folder).config(), (), trust=False)
        if _fits(job.env, settings):
            found[SHIPPED] = _policy(Run.open(folder), job, "last", device)
    else:
        opened = Run.open(run, "run")
        job, _ = flown_job(opened.config(), (), trust)
        for which, file in POLICIES.items():
            is_there = (run / file).exists() or (which == "last" and (run / CHECKPOINT).exists())
            if is_there:
                found[f"{which} policy"] = _policy(opened, job, which, device)
    return found


def _fits(trained: Settings, settings: Settings) -> bool:
    return (trained.task.name, trained.episode.control) == (
        settings.task.name,
        settings.episode.control,
    )


def _policy(run: Run, job: Job, which: str, device: torch.device) -> Player:
    @cache
    def loaded() -> MakeController:
        return acting(load_agent(run, job, device, which).actor)

    def make(simulation: Simulation) -> Controller:
        return loaded()(simulation)

    return Player(make, job.env)


def seen_by(player: Player, settings: Settings) -> Settings | None:
    """The page's scene with what a policy sees of it; errors as for ``Settings``."""
    if player.sees is None:
        return None
    own = player.sees
    names = ("cams", "image_size", "quality", "obs", "renderings")
    seen: Mapping[str, object] = {name: getattr(own, name) for name in names}
    return replace(settings, **seen)  # pyright: ignore
