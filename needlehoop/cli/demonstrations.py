"""``needlehoop demonstrations``: episodes as a dataset for learners elsewhere."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import add_command
from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed

if TYPE_CHECKING:
    from needlehoop.demonstrations.episodes import Demonstration
    from needlehoop.envs.rollout import MakeController
    from needlehoop.envs.settings import Settings

_OWN = (
    *("demonstrator", "episodes", "out", "format", "overwrite", "device", "seed", "engine"),
    "trust",
)
"""Keys that go together with a run as the demonstrator, whose environment is its own."""


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    add_command(
        commands,
        "demonstrations",
        _demonstrations,
        "Write episodes of an expert or a trained run as a dataset: Minari or LeRobot.",
        "demonstrator=<controller>|perturbed|<run folder> episodes=200 out=demos/smooth-v0"
        " format=minari|lerobot overwrite=false device=auto trust=false",
    )


def _demonstrations(options: argparse.Namespace) -> None:
    from needlehoop.config import composing
    from needlehoop.demonstrations.episodes import About, demonstrate
    from needlehoop.demonstrations.export import layout, new_folder
    from needlehoop.runs.machine import provenance

    words = options.overrides
    values = composing.compose(words, "demonstrations")
    episodes, kind = strict.value(values, "episodes", Count), strict.value(values, "format", str)
    write, out = layout(kind), Path(strict.value(values, "out", str))
    if kind == "minari":
        from needlehoop.demonstrations.minari_layout import check_name

        check_name(out.name)
    who, settings, make = _demonstrator(values, words)
    with new_folder(out, strict.value(values, "overwrite", bool)) as folder:
        shown = _Shown(demonstrate(settings, make, episodes), episodes)
        write(folder, shown, About(who, settings, provenance()))
    print(f"{out}: {episodes} episodes, {shown.steps} steps, {shown.succeeded} successful")


def _demonstrator(values: dict[str, Any], words: list[str]) -> tuple[str, Settings, MakeController]:
    """Its name, the environment, and what acts in it."""
    from needlehoop.demonstrations.episodes import scripted
    from needlehoop.envs.settings import settings_from
    from needlehoop.learning.evaluate import acting, load_agent
    from needlehoop.learning.job import pick_device, recorded_job
    from needlehoop.runs.run import Run

    who, where = (
        strict.value(values, "demonstrator", str | None),
        strict.value(values, "device", str),
    )
    if who is None or not Path(who).is_dir():
        settings = settings_from(values)
        who = who or settings.definition.teacher
        return who, settings, scripted(who, settings.definition)
    given = [word.partition("=")[0].lstrip("+~") for word in words]
    foreign = [key for key in given if key.partition(".")[0] not in _OWN]
    if foreign:
        raise ValueError(
            f"{foreign[0]}: a run demonstrates in its own environment; with it, choose from"
            f" {', '.join(_OWN)}"
        )
    run = Run.open(Path(who))
    job = recorded_job(run.config(), strict.value(values, "trust", bool))
    device = pick_device(where)
    seed = strict.value(values, "seed", Seed)
    if seed == job.env.seed:
        raise ValueError(f"seed: the run was trained on {seed}; choose another")
    settings = replace(job.env, seed=seed, engine=settings_from(values).engine)
    return who, settings, acting(load_agent(run, job, device).actor)


class _Shown:
    """Episodes with a progress bar, counted."""

    def __init__(self, episodes: Iterable[Demonstration], total: int):
        self._episodes, self._total = episodes, total
        self.steps = self.succeeded = 0

    def __iter__(self) -> Iterator[Demonstration]:
        from tqdm import tqdm

        for one in tqdm(self._episodes, total=self._total, unit="episode", dynamic_ncols=True):
            self.steps += len(one)
            self.succeeded += one.success
            yield one
