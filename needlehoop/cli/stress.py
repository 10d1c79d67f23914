"""``needlehoop stress``: what disturbances cost a policy."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop.cli.look import Levels
from needlehoop.config import strict
from needlehoop.config.strict import Count, Number, Seed


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    stressed = commands.add_parser(
        "stress",
        help="Test a policy under disturbances of cameras, pictures, scene and robot.",
        description="Fly the same episodes undisturbed, and under each axis of disturbance at each"
        " severity, and write a table of what came of it: stress.csv in the run's folder. What"
        " an earlier test wrote is kept under a number.",
        epilog="Keys: axes=[camera,picture.blur] severities=[1,3,5] together=3 episodes=100 seed=…"
        " num_envs=100 threads=0 out=… device=auto trust=false; and conditions, such as task=wide.",
    )
    stressed.add_argument(
        "who", metavar="WHO", help="a run's folder, a policy.safetensors, or expert, smooth, …"
    )
    stressed.add_argument("overrides", nargs="*", metavar="key=value")
    stressed.set_defaults(run=_stress)


def _stress(options: argparse.Namespace) -> None:
    from needlehoop.config import composing
    from needlehoop.config.changing import parted
    from needlehoop.learning.job import pick_device
    from needlehoop.runs.files import STRESS, csv_text, set_aside, write_whole

    who = Path(options.who)
    words, conditions = parted(options.overrides, "stress")
    asked = strict.read(
        composing.compose(words, "stress"),
        axes=tuple[str, ...],
        severities=tuple[Count, ...],
        together=Count,
        levels=Levels,
        episodes=Count,
        seed=Seed | None,
        num_envs=Count,
        threads=Number,
        out=str | None,
        device=str,
        trust=bool,
    )
    if asked.out is None and (conditions or not who.is_dir()):
        raise ValueError(
            "out: stress.csv in a run's folder is of the run's own conditions; name another file,"
            " such as out=stress.csv"
        )
    target = who / STRESS if asked.out is None else Path(asked.out)
    if target.suffix != ".csv":
        raise ValueError(f"out: {str(target)!r} must end in .csv")
    device = pick_device(asked.device)
    from needlehoop.learning import stress
    from needlehoop.learning.subject import subject

    tested = subject(options.who, conditions, asked.seed, device, asked.trust)
    chosen = stress.chosen_axes(asked.axes, blind=tested.blind)
    tried = stress.conditions(asked.levels, chosen, asked.severities, asked.together)
    engine = replace(tested.settings.engine, threads=asked.threads)
    settings = replace(tested.settings, engine=engine)
    rows = stress.stress(settings, tested.make, tried, asked.episodes, asked.num_envs)
    set_aside(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_whole(target, csv_text(rows[0], (row.values() for row in rows)))
    print(f"{stress.summary(rows)}\ntable        {target}")
