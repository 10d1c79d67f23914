"""``needlehoop bench``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from needlehoop.cli.command import add_command
from needlehoop.config.strict import Count, Range

Rounds = Annotated[int, Range(1, 1_000_000)]


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    bench = add_command(
        commands,
        "bench",
        _bench,
        "Measure the environment's speed (the default), training's, Stable-Baselines3's on it, a"
        " reward program's or that of small commands, or the physics' stability.",
        "speed|train|sb3|stability|program|startup (a bare word, or what=…) rounds=5 steps=40"
        " episodes=1000; with train: turns=3 against=<folder of another checkout>",
    )
    bench.add_argument("--json", action="store_true", help="print one line of JSON")


def _bench(options: argparse.Namespace) -> None:
    given = [f"what={word}" if "=" not in word else word for word in options.overrides]
    # Training has a config of its own, in which there is nothing else to choose.
    learning = [word for word in given if word in ("what=train", "what=sb3")]
    rest = [word for word in given if word not in learning]
    found = _measure_learning(learning[-1], rest) if learning else _measure(given)
    if options.json:
        print(json.dumps(found))
    else:
        _print_nested(found)


def _measure(overrides: list[str]) -> dict[str, Any]:
    from needlehoop.config import composing, strict

    values = composing.compose(overrides, "bench")
    from needlehoop.envs.settings import settings_from

    settings, what = settings_from(values), strict.value(values, "what", str)
    if what == "speed":
        from needlehoop.bench.speed import measure

        rounds, steps = (strict.value(values, key, Rounds) for key in ("rounds", "steps"))
        return measure(settings, rounds, steps)
    if what == "stability":
        from needlehoop.bench.stability import shake

        return shake(settings, strict.value(values, "episodes", Count)).as_dict()
    if what == "program":
        from needlehoop.bench.program import measure_program

        return measure_program(settings.num_envs, strict.value(values, "rounds", Rounds))
    if what == "startup":
        from needlehoop.bench.startup import measure_startup

        return measure_startup(strict.value(values, "rounds", Rounds))
    valid = "speed, train, sb3, stability, program, startup"
    raise ValueError(f"what: {what!r} is unknown; choose from {valid}")


def _measure_learning(what: str, overrides: list[str]) -> dict[str, Any]:
    from needlehoop.config import composing, strict

    values = composing.compose(overrides, "bench_train")
    from needlehoop.learning.job import typed_job

    job, rounds = typed_job(values), strict.value(values, "rounds", Rounds)
    if what == "what=sb3":
        from needlehoop.bench.stable_baselines import measure_sb3

        return measure_sb3(job, rounds)
    from needlehoop.bench.against import compare_training
    from needlehoop.bench.training import measure_training

    against = strict.value(values, "against", str | None)
    if against is None:
        return measure_training(job, rounds, alone=strict.value(values, "alone", bool))
    own = ("against=", "turns=")
    words = [word for word in overrides if not word.startswith(own)]
    return compare_training(Path(against).resolve(), words, strict.value(values, "turns", Rounds))


def _print_nested(values: Mapping[str, Any], indent: str = "") -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            print(f"{indent}{name}:")
            _print_nested(value, indent + "  ")
        else:
            print(f"{indent}{name}: {value}")
