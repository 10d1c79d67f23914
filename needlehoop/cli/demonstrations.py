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


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    add_command(
        commands,
        "demonstrations",
        _demonstrations,
        "Write episodes of an expert or a trained run as a dataset: Minari or LeRobot.",
        "demonstrator=<controller>|perturbed|<run folder> episodes=200 out=demos/smooth-v0"
        " format=minari|lerobot overwrite=false device=auto trust=false; of a run, seed= and any"
        " condition, changed",
    )


def _demonstrations(options: argparse.Namespace) -> None:
    from needlehoop.config import composing
    from needlehoop.config.changing import parted
    from needlehoop.demonstrations.episodes import About, demonstrate
    from needlehoop.demonstrations.export import layout, new_folder
    from needlehoop.runs.machine import provenance

    words, conditions = options.overrides, []
    named = [word.partition("=")[2] for word in words if word.startswith("demonstrator=")]
    if named and Path(named[-1]).is_dir():
        own, others = parted(words, "demonstrations")
        conditions = [word for word in others if not word.startswith("seed=")]
        words = [*own, *(word for word in others if word not in conditions)]
    values = composing.compose(words, "demonstrations")
    asked = strict.read(
        values,
        demonstrator=str | None,
        episodes=Count,
        format=str,
        out=str | None,
        overwrite=bool,
        device=str,
        trust=bool,
        seed=Seed,
    )
    write, place = layout(asked.format), asked.out
    if not place:
        raise ValueError("out: give a folder for the dataset, such as out=demos/smooth-v0")
    out = Path(place)
    if asked.format == "minari":
        from needlehoop.demonstrations.minari_layout import check_name

        check_name(out.name)
    has_seed = any(word.startswith("seed=") for word in words)
    who, settings, make = _demonstrator(asked, values, conditions, has_seed)
    with new_folder(out, asked.overwrite) as folder:
        shown = _Shown(demonstrate(settings, make, asked.episodes), asked.episodes)
        write(folder, shown, About(who, settings, provenance()))
    print(
        f"{out}: {asked.episodes} episodes (seed {settings.seed}), {shown.steps} steps,"
        f" {shown.succeeded} successful"
    )


def _demonstrator(
    asked: Any, values: dict[str, Any], conditions: list[str], has_seed: bool
) -> tuple[str, Settings, MakeController]:
    """Its name, the environment, and what acts in it.

    Args:
        asked: values of the command's own keys.
        values: the composed config.
        conditions: words that change a run's; a run demonstrates in its own environment.
        has_seed: whether a seed was typed; a run's is otherwise one that it has not met.
    """
    from needlehoop.demonstrations.episodes import scripted
    from needlehoop.envs.settings import settings_from
    from needlehoop.learning.evaluate import acting, load_agent, which_policy
    from needlehoop.learning.flight import flown_job
    from needlehoop.learning.job import pick_device
    from needlehoop.runs.run import Run

    who = asked.demonstrator
    if who is None or not Path(who).is_dir():
        settings = settings_from(values)
        who = who or settings.definition.teacher
        return who, settings, scripted(who, settings.definition)
    run = Run.open(Path(who))
    job, _ = flown_job(run.config(), conditions, asked.trust, "demonstrations")
    which, _ = which_policy(run, None)
    # After those of its evaluations and of watch.
    seed = asked.seed if has_seed else job.evaluation.final_seed + 2
    if seed == job.env.seed:
        raise ValueError(f"seed: the run was trained on {seed}; choose another")
    agent = load_agent(run, job, pick_device(asked.device), which)
    return who, replace(job.env, seed=seed), acting(agent.actor)


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
