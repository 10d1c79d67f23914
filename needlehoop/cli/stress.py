"""``needlehoop stress``: what disturbances cost a policy."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop.cli.look import Levels
from needlehoop.config import strict
from needlehoop.config.strict import Count, Number, Seed

_OWN = (
    *("axes", "severities", "together", "episodes", "seed", "num_envs", "threads", "out"),
    *("levels", "device", "trust"),
)
"""Keys of the command itself; all others are an environment's."""


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
    from needlehoop.learning.job import pick_device
    from needlehoop.runs.files import STRESS, set_aside

    who = Path(options.who)
    own = [word for word in options.overrides if re.split(r"[=.]", word)[0] in _OWN]
    conditions = [word for word in options.overrides if word not in own]
    values = composing.compose(own, "stress")
    severities = strict.value(values, "severities", tuple[Count, ...])
    levels = strict.value(values, "levels", Levels)
    episodes, envs, together = (
        strict.value(values, key, Count) for key in ("episodes", "num_envs", "together")
    )
    seed, threads = (
        strict.value(values, "seed", Seed | None),
        strict.value(values, "threads", Number),
    )
    axes, trust = strict.value(values, "axes", tuple[str, ...]), strict.value(values, "trust", bool)
    out = strict.value(values, "out", str | None)
    if out is None and (conditions or not who.is_dir()):
        raise ValueError(
            "out: stress.csv in a run's folder is of the run's own conditions; name another file,"
            " such as out=stress.csv"
        )
    target = who / STRESS if out is None else Path(out)
    if target.suffix != ".csv":
        raise ValueError(f"out: {str(target)!r} must end in .csv")
    device = pick_device(strict.value(values, "device", str))
    from needlehoop.learning import stress
    from needlehoop.learning.subject import subject

    tested = subject(options.who, conditions, seed, device, trust)
    chosen = stress.chosen_axes(axes, blind=tested.blind)
    tried = stress.conditions(levels, chosen, severities, together)
    engine = replace(tested.settings.engine, threads=threads)
    rows = stress.stress(
        replace(tested.settings, engine=engine), tested.make, tried, episodes, envs
    )
    set_aside(target)
    stress.write(rows, target)
    print(f"{stress.summary(rows)}\ntable        {target}")
