"""Sweeps: what is checked before the first run, how each run ended, how many CPUs it may use."""

from __future__ import annotations

import json
import math
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.experimental.callback import Callback

from needlehoop.config import composing
from needlehoop.runs.files import (
    OUTCOME,
    labelled,
    name_of,
    seen,
    taught_by,
    write_whole,
)
from needlehoop.runs.machine import HeldError, available_cpus
from needlehoop.runs.reading import UnreadableError, printable, read_json

_SEARCH, _DIRECTION = "hydra/sweeper=optuna", "hydra.sweeper.direction="

_IN_PATH = ("cams", "seed", "study", "results", "label", "reward.name", "obs.signals")
_CHOICE_IN_PATH = {"algo": ("ppo", "dagger"), "obs": ("images", "signals")}
"""Keys, and choices of others, that a run's path says without a label."""

STOPPED, FAILED, HELD = "stopped", "failed", "under way elsewhere"
UNDER_WAY = "under way"
"""What a note says until its run has ended, or for ever if the process was killed."""


def direction(words: Sequence[str]) -> list[str]:
    """What a search is told beside what was typed: to make its objective high, not low."""
    is_told = any(word.startswith(_DIRECTION) for word in words)
    return [f"{_DIRECTION}maximize"] if _SEARCH in words and not is_told else []


class Sweep(Callback):
    """What Hydra calls before a sweep's first run and after its last, where it was started."""

    def on_multirun_start(self, config: Any, **kwargs: Any) -> None:
        """Ends the process where a run's settings are wrong, or its reward cannot be had."""
        sweeper, typed = config.hydra.sweeper, config.hydra.overrides.task
        # Other sweepers choose their runs later.
        if not sweeper._target_.endswith(".BasicSweeper"):
            return
        words = [*(f"{key}={value}" for key, value in (sweeper.params or {}).items()), *typed]
        # Folders of one's own are among Hydra's settings.
        place = [w for w in config.hydra.overrides.hydra if w.startswith("hydra.searchpath=")]
        try:
            for run in combinations(words):
                check_run([*place, *run])
        except ValueError as error:
            sys.exit(f"nothing was started: {error}")

    def on_multirun_end(self, config: Any, **kwargs: Any) -> None:
        """Says what is missing; the exit status is then 1."""
        folder = Path(config.hydra.sweep.dir)
        lines, undone = summary(folder)
        print("\n".join(lines))
        # What Optuna's sweeper writes: the best settings.
        file = folder / "optimization_results.yaml"
        if file.exists():
            print(f"{file}:\n{file.read_text()}", end="")
        if undone:
            sys.exit("the same command, without overwrite=true, does what is missing")


def combinations(words: Iterable[str]) -> list[list[str]]:
    """The words of each of a sweep's runs, whose seed is left out: it changes no other setting.

    A later word replaces an earlier one of the same key.
    """
    choices = {}
    for word in OverridesParser.create().parse_overrides(list(words)):
        key, is_swept = word.get_key_element(), word.is_sweep_override()
        values = word.sweep_string_iterator() if is_swept else [word.get_value_element_as_str()]
        choices[key] = [f"{key}={value}" for value in values]
    choices.pop("seed", None)
    return [list(run) for run in product(*choices.values())]


def check_run(words: list[str]) -> None:
    """Raises ``ValueError`` for wrong settings of a run, or a program that is not there.

    It is no mistake where a model will be asked to write the program.
    """
    from needlehoop import rewards
    from needlehoop.rewards import program_reward
    from needlehoop.training.session import checked

    values = composing.compose_here(words, "config")
    _, job = checked(values)
    reward: Mapping[str, Any] = values["reward"]
    if values["vlm"]["kind"] == "replay" or program_reward.is_recorded(reward):
        rewards.check(reward, job.env.definition)


def camera_sets(experiment: str) -> list[str]:
    """The camera sets over which an experiment sweeps, in the order of their names: ``a+b``."""
    params = composing.swept([f"+experiment={experiment}"])
    (cams,) = OverridesParser.create().parse_overrides([f"cams={params.get('cams', '[]')}"])
    values: list[Any] = [*cams.sweep_iterator()] if cams.is_sweep_override() else [cams.value()]
    return sorted({seen([value] if isinstance(value, str) else value) for value in values})


def identity(values: Mapping[str, Any], overrides: list[str]) -> dict[str, Any]:
    """The names of a sweep's run, for its note; its settings are not checked yet."""
    return {
        "run": " ".join(overrides),
        "study": values["study"],
        "cameras": seen(values["cams"], values["obs"]["signals"] is True),
        "reward": labelled(taught_by(values), values["label"]),
        "seed": values["seed"],
    }


def label_of(
    values: Mapping[str, Any], typed: Iterable[str], params: Mapping[str, Any], words: Iterable[str]
) -> str | None:
    """What tells a sweep's run from the others, where cameras, reward and seed do not.

    ``words``: those that the run was composed of. An experiment's sweeper adds ``params`` to the
    ``typed`` ones of the command line.
    """
    parse = OverridesParser.create().parse_overrides
    swept = {
        override.get_key_element()
        for override in parse([*(f"{key}={value}" for key, value in params.items()), *typed])
        if override.is_sweep_override()
    }
    differs = [
        (override.key_or_group, override.get_value_element_as_str())
        for override in parse([*words])
        if override.get_key_element() in swept and not _is_in_path(values, override)
    ]
    return "+".join(filter(None, (values["label"], name_of(differs)))) or None


def _is_in_path(values: Mapping[str, Any], word: Override) -> bool:
    """Whether a run's path without a label says already what a word chose."""
    key, choice = word.key_or_group, word.value()
    if key == "reward":
        return choice == taught_by(values)
    return key in _IN_PATH or choice in _CHOICE_IN_PATH.get(key, ())


def attempt(run: Callable[[], tuple[str, float]], folder: Path, note: Mapping[str, Any]) -> float:
    """Do one run of a sweep and note how it ended; a failure does not stop the others.

    ``run`` returns how it ended in a word, such as ``done``, and its objective, which is NaN where
    the run failed or is not done. Raises ``KeyboardInterrupt`` where somebody stopped the run.
    """

    def say(**end: str) -> None:
        write_whole(folder / OUTCOME, json.dumps({**note, **end}, indent=2) + "\n")

    say(outcome=UNDER_WAY)
    try:
        outcome, objective = run()
    except HeldError as error:
        # Another sweep may be at work on the same study.
        print(error, file=sys.stderr)
        say(outcome=HELD)
        return math.nan
    except Exception as error:
        # Any error: the next run may do better, and the summary names this one.
        log = folder / "error.log"
        write_whole(log, traceback.format_exc())
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        print(printable(f"{note['run']}: {reason} ({log})"), file=sys.stderr)
        say(outcome=FAILED, error=reason)
        return math.nan
    say(outcome=outcome)
    if outcome == STOPPED:
        raise KeyboardInterrupt
    return objective


def summary(folder: Path) -> tuple[list[str], int]:
    """How the jobs of a sweep ended, from the notes in its folder: in lines to print, and the
    number of jobs that failed, were killed, or found another process at work on their run.
    """
    outcomes: Counter[str] = Counter()
    lines = []
    jobs = [int(job.name) for job in folder.iterdir() if job.name.isdigit()]
    for job in (folder / str(number) for number in sorted(jobs)):
        try:
            note = read_json(job / OUTCOME)
        except UnreadableError:
            # Its process was killed before or while it wrote.
            note = {"run": str(job), "outcome": UNDER_WAY}
        outcomes[note["outcome"]] += 1
        if note["outcome"] in (FAILED, UNDER_WAY):
            lines.append(printable(f"  {note['run']}: {note.get('error', 'it was killed')}"))
    failed = outcomes[FAILED] + outcomes[UNDER_WAY]
    headline = f"{outcomes.total()} runs, {failed} failed"
    for other in ("done before", "paused", HELD):
        if outcomes[other]:
            headline += f", {outcomes[other]} {other}"
    return [headline, *lines], failed + outcomes[HELD]


def threads(launcher: Mapping[str, Any]) -> int:
    """Threads for each of a launcher's jobs, which share the CPUs; 0 is every CPU."""
    cpus = available_cpus()
    if "n_jobs" in launcher:
        # joblib: -1 is one job per CPU, -2 one fewer, and so on.
        jobs = launcher["n_jobs"]
        return max(1, cpus // (jobs if jobs > 0 else max(1, cpus + 1 + jobs)))
    if launcher.get("cpus_per_task"):
        return int(launcher["cpus_per_task"])
    share = ((launcher.get("ray") or {}).get("remote") or {}).get("num_cpus")
    return max(1, int(share)) if share else 0
