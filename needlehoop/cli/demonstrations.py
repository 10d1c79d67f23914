"""``needlehoop demonstrations``: episodes as a dataset for learners elsewhere."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import add_command
from needlehoop.config.strict import Count, Seed

if TYPE_CHECKING:
    from needlehoop.demonstrations.flights import Flight, Pilot
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
        "demonstrator=smooth|expert|perturbed|<run folder> episodes=200 out=demos/smooth-v0"
        " format=minari|lerobot overwrite=false device=auto trust=false",
    )


def _demonstrations(options: argparse.Namespace) -> None:
    from needlehoop.config import composing, strict
    from needlehoop.demonstrations.about import About
    from needlehoop.demonstrations.export import layout, new_folder
    from needlehoop.demonstrations.flights import fly
    from needlehoop.runs.provenance import provenance

    words = options.overrides
    values = composing.compose(words, "demonstrations")
    episodes, kind = strict.value(values, "episodes", Count), strict.value(values, "format", str)
    write, out = layout(kind), Path(strict.value(values, "out", str))
    if kind == "minari":
        from needlehoop.demonstrations.minari_layout import check_name

        check_name(out.name)
    who, settings, pilot = _demonstrator(values, words)
    with new_folder(out, strict.value(values, "overwrite", bool)) as folder:
        flown = _Shown(fly(settings, pilot, episodes), episodes)
        write(folder, flown, About(who, settings, provenance()))
    print(f"{out}: {episodes} episodes, {flown.steps} steps, {flown.succeeded} successful")


def _demonstrator(values: dict[str, Any], words: list[str]) -> tuple[str, Settings, Pilot]:
    """Its name, the environment, and who flies."""
    from needlehoop.config import strict
    from needlehoop.demonstrations.demonstrators import scripted
    from needlehoop.learning.evaluate import load_agent, pilots
    from needlehoop.learning.job import pick_device
    from needlehoop.runs.run import Run

    who, where = strict.value(values, "demonstrator", str), strict.value(values, "device", str)
    if not Path(who).is_dir():
        from needlehoop.envs.settings import settings_from

        return who, settings_from(values), scripted(who)
    given = [word.partition("=")[0].lstrip("+~") for word in words]
    foreign = [key for key in given if key.partition(".")[0] not in _OWN]
    if foreign:
        raise ValueError(
            f"{foreign[0]}: a run demonstrates in its own environment; with it, choose from"
            f" {', '.join(_OWN)}"
        )
    run = Run.open(Path(who))
    from needlehoop.learning.job import recorded_job

    job = recorded_job(run.config(), strict.value(values, "trust", bool))
    device = pick_device(where)
    seed = strict.value(values, "seed", Seed)
    if seed == job.env.seed:
        raise ValueError(f"seed: the run was trained on {seed}; choose another")
    from needlehoop.envs.settings import settings_from

    settings = replace(job.env, seed=seed, engine=settings_from(values).engine)
    return who, settings, pilots(load_agent(run, job, device))


class _Shown:
    """Episodes with a progress bar, counted."""

    def __init__(self, flights: Iterable[Flight], total: int):
        self._flights, self._total = flights, total
        self.steps = self.succeeded = 0

    def __iter__(self) -> Iterator[Flight]:
        from tqdm import tqdm

        for flight in tqdm(self._flights, total=self._total, unit="episode", dynamic_ncols=True):
            self.steps += len(flight)
            self.succeeded += flight.success
            yield flight
