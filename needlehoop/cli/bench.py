"""``needlehoop bench``."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Annotated, Any

import yaml

from needlehoop.cli.command import add_command, environment
from needlehoop.config import strict
from needlehoop.config.strict import Range

if TYPE_CHECKING:
    from needlehoop.envs.settings import Settings

Rounds = Annotated[int, Range(1, 1_000_000)]
WHAT = ("speed", "train", "sb3")


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    bench = add_command(
        commands,
        "bench",
        _bench,
        "Measure how fast the environment is on this machine (speed, the default), or training"
        " (train), or Stable-Baselines3 on it (sb3).",
        "speed|train|sb3 (a bare word, or what=…) rounds=5; with speed: steps=40; with train and"
        " sb3: all of conf/job.yaml; with train: against=disturb=none, another training in turns",
    )
    bench.add_argument("--json", action="store_true", help="print one line of JSON")


def _bench(options: argparse.Namespace) -> None:
    given = [f"what={word}" if "=" not in word else word for word in options.overrides]
    chosen = [word.partition("=")[2] for word in given if word.startswith("what=")]
    what = (chosen or ["speed"])[-1]
    if what not in WHAT:
        raise ValueError(f"what: {what!r} is unknown; choose from {', '.join(WHAT)}")
    other = [word.partition("=")[2] for word in given if word.startswith("against=")]
    if other and what != "train":
        raise ValueError(f"against: bench {what} compares nothing; bench train does")
    words = [word for word in given if word.partition("=")[0] not in ("what", "against")]
    options.overrides = words
    found = _measure(options) if what == "speed" else _measure_learning(what, words, other)
    if options.json:
        print(json.dumps(found))
    else:
        print(yaml.safe_dump(found, sort_keys=False), end="")


def _measure(options: argparse.Namespace) -> dict[str, Any]:
    settings, values = environment(options, "bench")
    asked = strict.read(values, rounds=Rounds, steps=Rounds)
    _check_cameras(settings)
    from needlehoop.bench.speed import measure

    return measure(settings, asked.rounds, asked.steps)


def _measure_learning(what: str, overrides: list[str], against: list[str]) -> dict[str, Any]:
    from needlehoop.config import composing

    values = composing.compose(overrides, "bench_train")
    other = composing.compose([*overrides, *against], "bench_train") if against else None
    from needlehoop.learning.job import typed_job

    job, rounds = typed_job(values), strict.value(values, "rounds", Rounds)
    _check_cameras(job.env)
    if what == "sb3":
        from needlehoop.bench.stable_baselines import measure_sb3

        return measure_sb3(job, rounds)
    from needlehoop.bench.speed import measure_training

    return measure_training(job, rounds, None if other is None else typed_job(other))


def _check_cameras(settings: Settings) -> None:
    if not settings.cams:
        raise ValueError("cams: the benchmark needs at least one camera")
