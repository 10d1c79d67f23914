"""``needlehoop demonstrations``: episodes as a dataset for learners elsewhere."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
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
    from tqdm import tqdm

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
    seed = asked.seed if any(word.startswith("seed=") for word in words) else None
    who, settings, make = _demonstrator(asked, values, conditions, seed)
    counts = Counter()

    def shown() -> Iterator[Demonstration]:
        found = demonstrate(settings, make, asked.episodes)
        for one in tqdm(found, total=asked.episodes, unit="episode", dynamic_ncols=True):
            counts.update(steps=len(one), successful=int(one.success))
            yield one

    with new_folder(out, asked.overwrite) as folder:
        write(folder, shown(), About(who, settings, provenance()))
    print(
        f"{out}: {asked.episodes} episodes (seed {settings.seed}), {counts['steps']} steps,"
        f" {counts['successful']} successful"
    )


def _demonstrator(
    asked: Any, values: dict[str, Any], conditions: list[str], seed: int | None
) -> tuple[str, Settings, MakeController]:
    """Its name, the environment, and what acts in it.

    Args:
        conditions: words that change a run's; a run demonstrates in its own environment.
        seed: that was typed; a run's is otherwise one that it has not met.
    """
    from needlehoop.demonstrations.episodes import scripted
    from needlehoop.envs.settings import settings_from
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import of_run

    who = asked.demonstrator
    if who is None or not Path(who).is_dir():
        settings = settings_from(values)
        who = who or settings.definition.teacher
        return who, settings, scripted(who, settings.definition)
    device = pick_device(asked.device)
    # After those of its evaluations and of watch.
    more = (asked.trust, "demonstrations", 2)
    return who, *of_run(Path(who), conditions, seed, device, *more)
