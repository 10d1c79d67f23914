"""Sweeps: what is checked before the first run, how each run ended, how many CPUs it may use."""

from __future__ import annotations

import json
import math
import re
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.experimental.callback import Callback

from needlehoop.config import composing
from needlehoop.runs.files import (
    OUTCOME,
    labelled,
    listed,
    name_of,
    seen,
    taught_by,
    write_whole,
)
from needlehoop.runs.lock import HeldError
from needlehoop.runs.machine import available_cpus
from needlehoop.runs.reading import UnreadableError, printable, read_json

MULTIRUN = {"-m", "--multirun"}

_SEARCH, _DIRECTION = "hydra/sweeper=optuna", "hydra.sweeper.direction="

_EXTRA = re.compile(r"hydra/(launcher|sweeper)=(joblib|ray|slurm|optuna)")
"""A plugin of Hydra's as it is typed; its value is the name of our extra."""

_IN_PATH = ("cams", "model", "seed", "study", "results", "label", "reward.name", "obs.signals")
_TOLD = {"algo": ("ppo", "dagger"), "obs": ("images", "signals")}
"""Keys, and choices of others, that a run's path says without a label."""

STOPPED, FAILED, HELD = "stopped", "failed", "under way elsewhere"
UNDER_WAY = "under way"
"""What a note says until its run has ended: for good, where the process was killed."""


def check_plugin(word: str) -> None:
    """Raises ``ValueError`` for a launcher or a sweeper of Hydra's that is not installed."""
    if chosen := _EXTRA.fullmatch(word):
        kind, extra = chosen.groups()
        package = f"hydra_plugins.hydra_{'submitit' if extra == 'slurm' else extra}_{kind}"
        if find_spec("hydra_plugins") is None or find_spec(package) is None:
            raise ValueError(f"{word} is not installed: pip install 'needlehoop[{extra}]'")


def reminder(words: Sequence[str]) -> str | None:
    """A hint for ``-m cams=a,b``, where one run with both cameras may have been meant.

    Returns:
        A line, if all that was typed after ``cams=`` are cameras of different views.
    """
    if not MULTIRUN & set(words):
        return None
    for word in words:
        key, _, value = word.partition("=")
        names = [name.strip() for name in value.split(",")]
        views = {name.partition("_")[2] for name in names}
        if key == "cams" and "[" not in value and len(views) == len(names) > 1 and all(views):
            return (
                f"-m {word} is {len(names)} runs of one camera each; one run that sees them all is"
                f" 'cams=[{','.join(names)}]'"
            )
    return None


def direction(words: Sequence[str]) -> list[str]:
    """What a search is told beside what was typed: to make its objective high, not low."""
    is_told = any(word.startswith(_DIRECTION) for word in words)
    return [f"{_DIRECTION}maximize"] if _SEARCH in words and not is_told else []


class Sweep(Callback):
    """What Hydra calls before a sweep's first run and after its last, where it was started."""

    def on_multirun_start(self, config: Any, **kwargs: Any) -> None:
        """Ends the process where a run's settings are wrong, or its reward cannot be had."""
        if str(config.hydra.launcher._target_).endswith(".JoblibLauncher"):
            from needlehoop.training.side_by_side import use_own_processes

            use_own_processes()
        sweeper, typed = config.hydra.sweeper, config.hydra.overrides.task
        # Another sweeper decides later what it runs.
        if not sweeper._target_.endswith(".BasicSweeper"):
            return
        words = [*(f"{key}={value}" for key, value in (sweeper.params or {}).items()), *typed]
        # Folders of one's own are among Hydra's settings.
        place = [w for w in config.hydra.overrides.hydra if w.startswith("hydra.searchpath=")]
        try:
            runs, seeds = parted(words)
            found = wrong_programs([[*place, *run] for run in runs], seeds)
        except ValueError as error:
            sys.exit(f"nothing was started: {error}")
        if found:
            sys.exit("\n".join(("nothing was started: these rewards cannot be had", *found)))

    def on_multirun_end(self, config: Any, **kwargs: Any) -> None:
        """Says what is missing; the exit status is then 1."""
        folder = Path(config.hydra.sweep.dir)
        lines, undone = summary(folder)
        print("\n".join(lines))
        # What Optuna's sweeper writes: the best settings.
        found = folder / "optimization_results.yaml"
        if found.exists():
            print(f"{found}:\n{found.read_text()}", end="")
        if undone:
            print(rest(config.existing, config.overwrite))
            sys.exit(1)


def parted(words: Iterable[str]) -> tuple[list[list[str]], list[Any]]:
    """A sweep's runs without seeds, as Hydra's basic sweeper makes them; and its seeds, if any."""
    runs, seeds = [], []
    for one in OverridesParser.create().parse_overrides(list(words)):
        if one.get_key_element() == "seed":
            seeds = [*one.sweep_iterator()] if one.is_sweep_override() else [one.value()]
        else:
            runs.append(one)
    return [*BasicSweeper.split_arguments(runs, None)[0]], seeds


def wrong_programs(runs: Iterable[list[str]], seeds: Sequence[Any]) -> list[str]:
    """What is wrong with the programs of runs, a line for each.

    A program that is not there is no mistake where a model will be asked to write it.

    Args:
        seeds: of each; none: that of the config.

    Raises:
        ValueError: another mistake in the settings of a run.
    """
    from needlehoop import rewards
    from needlehoop.rewards import program_reward
    from needlehoop.tasks.registry import find
    from needlehoop.training.options import check_options

    lines: dict[str, None] = {}
    for run in runs:
        values = composing.compose_here(run, "config")
        for seed in seeds or [values["seed"]]:
            check_options({**values, "seed": seed})
        reward: Mapping[str, Any] = values["reward"]
        if reward["kind"] not in program_reward.KINDS or values["resume"] is not None:
            continue
        if not program_reward.is_recorded(reward):
            if values["vlm"]["kind"] != "replay":
                continue
            flavour, cams = program_reward.FLAVOURS[reward["kind"]], listed(reward["cams"])
            asking = program_reward.command(
                cams, flavour, str(reward["study"]), str(reward["results"])
            )
            lines[f"  {'+'.join(cams)}: none of {flavour}; make it with: {asking}"] = None
            continue
        try:
            rewards.load(reward, find(values["task"]["name"]))
        except ValueError as error:
            lines[f"  {error}"] = None
    return list(lines)


def identity(values: Mapping[str, Any], overrides: list[str]) -> dict[str, Any]:
    """The names of a sweep's run, for its note; its settings are not checked yet.

    Args:
        overrides: what makes this run differ from the others.
    """
    return {
        "run": " ".join(overrides),
        "study": values["study"],
        "cameras": seen(listed(values["cams"]), values["obs"]["signals"] is True),
        "reward": labelled(taught_by(values), values["label"]),
        "seed": values["seed"],
    }


def label_of(
    values: Mapping[str, Any], typed: Iterable[str], params: Mapping[str, Any], own: Iterable[str]
) -> str | None:
    """What tells a sweep's run from the others, where cameras, reward and seed do not.

    Args:
        typed: words of the command line, without flags.
        params: what an experiment's sweeper adds to them.
        own: the words that the run itself was composed of.
    """
    parse = OverridesParser.create().parse_overrides
    swept = {
        one.get_key_element()
        for one in parse([*(f"{key}={value}" for key, value in params.items()), *typed])
        if one.is_sweep_override()
    }
    differs = [
        (one.key_or_group, one.get_value_element_as_str())
        for one in parse([*own])
        if one.get_key_element() in swept and not _is_in_path(values, one)
    ]
    return "+".join(filter(None, (values["label"], name_of(differs)))) or None


def _is_in_path(values: Mapping[str, Any], word: Override) -> bool:
    """Whether a run's path without a label says already what a word chose."""
    key, choice = word.key_or_group, word.value()
    if key == "reward":
        return choice == taught_by(values)
    return key in _IN_PATH or choice in _TOLD.get(key, ())


def attempt(run: Callable[[], tuple[str, float]], folder: Path, note: Mapping[str, Any]) -> float:
    """Do one run of a sweep and note how it ended; a failure does not stop the others.

    Args:
        run: does it; returns how it ended in a word, such as ``done``, and its objective.

    Returns:
        The objective; NaN where the run failed or is not done.

    Raises:
        KeyboardInterrupt: somebody stopped the run, and with it the sweep.
    """
    write_whole(folder / OUTCOME, json.dumps({**note, "outcome": UNDER_WAY}, indent=2) + "\n")
    objective = math.nan
    try:
        outcome, objective = run()
        end = {"outcome": outcome}
    except HeldError as error:
        # Another sweep may be at work on the same study.
        print(error, file=sys.stderr)
        end = {"outcome": HELD}
    except Exception as error:
        # Any error: the next run may do better, and the summary names this one.
        log = folder / "error.log"
        write_whole(log, traceback.format_exc())
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        print(printable(f"{note['run']}: {said} ({log})"), file=sys.stderr)
        end = {"outcome": FAILED, "error": said}
    write_whole(folder / OUTCOME, json.dumps({**note, **end}, indent=2) + "\n")
    if end["outcome"] == STOPPED:
        raise KeyboardInterrupt
    return objective


def summary(folder: Path) -> tuple[list[str], int]:
    """How the jobs of a sweep ended, from the notes in its folder.

    Returns:
        Lines to print, and the number of jobs that failed, were killed, or found their run in
        the hands of another process.
    """
    jobs = sorted(
        (job for job in folder.iterdir() if job.name.isdigit()), key=lambda job: int(job.name)
    )
    outcomes: Counter[str] = Counter()
    lines = []
    for job in jobs:
        try:
            note = read_json(job / OUTCOME)
        except UnreadableError:
            # Its process was killed before or while it wrote.
            outcomes[FAILED] += 1
            lines.append(f"  {job}: ended without a word")
            continue
        outcomes[note["outcome"]] += 1
        if note["outcome"] in (FAILED, UNDER_WAY):
            place = f"{note['cameras']}/{note['reward']}/seed{note['seed']}"
            lines.append(printable(f"  {place}: {note.get('error', 'its process was killed')}"))
    failed = outcomes[FAILED] + outcomes[UNDER_WAY]
    told = f"{len(jobs)} runs, {failed} failed"
    for other in ("done before", "paused", HELD):
        if outcomes[other]:
            told += f", {outcomes[other]} {other}"
    return [told, *lines], failed + outcomes[HELD]


def rest(existing: str, overwrite: bool) -> str:
    """How to finish a sweep with these settings."""
    changes = [] if existing in ("auto", "resume") else ["with existing=resume"]
    changes += ["without overwrite=true"] if overwrite else []
    return " ".join(("the same command", *changes, "does what is missing"))


def threads(launcher: Mapping[str, Any]) -> int:
    """Threads for each of a launcher's jobs, so that they do not crowd each other.

    Returns:
        0, which is every CPU, where jobs run one after the other or have CPUs of their own.
    """
    cpus = available_cpus()
    if "n_jobs" in launcher:
        # joblib: -1 is one job per CPU, -2 one fewer, and so on.
        asked = launcher["n_jobs"]
        return max(1, cpus // (asked if asked > 0 else max(1, cpus + 1 + asked)))
    if launcher.get("cpus_per_task"):
        return int(launcher["cpus_per_task"])
    own = ((launcher.get("ray") or {}).get("remote") or {}).get("num_cpus")
    return max(1, int(own)) if own else 0
