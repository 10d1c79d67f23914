"""Sweeps: how each run ended, and how many CPUs it may use."""

from __future__ import annotations

import json
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.experimental.callback import Callback

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

_IN_PATH = ("cams", "model", "seed", "study", "results", "label", "reward.name", "obs.signals")
_TOLD = {"algo": ("ppo", "dagger"), "obs": ("images", "signals")}
"""Keys, and choices of others, that a run's path says without a label."""

RESUMING = ("auto", "resume")
"""Values of ``existing`` with which a sweep goes on with what is there."""

DONE_BEFORE, STOPPED, PAUSED = "done before", "stopped", "paused"
FAILED, HELD = "failed", "under way elsewhere"
UNDER_WAY = "under way"
"""What a note says until its run has ended: for good, where the process was killed."""

_FOUND = "optimization_results.yaml"
"""What Optuna's sweeper writes: the best settings."""

_LOG = "error.log"
"""In a failed job's folder: where in the source it failed."""


def identity(values: Mapping[str, Any], overrides: list[str]) -> dict[str, Any]:
    """The names of a sweep's run, for its note; its settings are not checked yet.

    Args:
        overrides: what makes this run differ from the others.
    """
    return {
        "run": " ".join(overrides),
        "study": values["study"],
        "cameras": seen(listed(values["cams"]), _part(values["obs"], "signals") is True),
        "reward": labelled(taught_by(values), values["label"]) if _is_grouped(values) else None,
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
    parts = [
        *([values["label"]] if values["label"] else []),
        *([name_of(differs)] if differs else []),
    ]
    return "+".join(parts) or None


def _is_in_path(values: Mapping[str, Any], word: Override) -> bool:
    """Whether a run's path without a label says already what a word chose."""
    key, choice = word.key_or_group, word.value()
    if key == "reward":
        return _is_grouped(values) and choice == taught_by(values)
    return key in _IN_PATH or choice in _TOLD.get(key, ())


def _is_grouped(values: Mapping[str, Any]) -> bool:
    """Whether the groups that name a run are groups."""
    return isinstance(values["algo"], Mapping) and _part(values["reward"], "kind") is not None


def _part(group: Any, key: str) -> Any:
    return group.get(key) if isinstance(group, Mapping) else None


def attempt(run: Callable[[], str], folder: Path, note: Mapping[str, Any]) -> None:
    """Do one run of a sweep and note how it ended; a failure does not stop the others.

    Args:
        run: does it; returns how it ended in a word, such as ``done``.

    Raises:
        KeyboardInterrupt: somebody stopped the run, and with it the sweep.
    """
    write_whole(folder / OUTCOME, json.dumps({**note, "outcome": UNDER_WAY}, indent=2) + "\n")
    try:
        end = {"outcome": run()}
    except HeldError as error:
        # Another sweep may be at work on the same study.
        print(error, file=sys.stderr)
        end = {"outcome": HELD}
    except Exception as error:
        # Any error: the next run may do better, and the summary names this one.
        log = folder / _LOG
        write_whole(log, traceback.format_exc())
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        print(printable(f"{note['run']}: {said} ({log})"), file=sys.stderr)
        end = {"outcome": FAILED, "error": said}
    write_whole(folder / OUTCOME, json.dumps({**note, **end}, indent=2) + "\n")
    if end["outcome"] == STOPPED:
        raise KeyboardInterrupt


class Summary(Callback):
    """Says at a sweep's end what is missing; the exit status is then 1."""

    def on_multirun_end(self, config: Any, **kwargs: Any) -> None:
        """Called by Hydra where the sweep was started."""
        lines, undone = summary(Path(config.hydra.sweep.dir))
        print("\n".join(lines))
        found = Path(config.hydra.sweep.dir) / _FOUND
        if found.exists():
            print(f"{found}:\n{found.read_text()}", end="")
        if undone:
            print(rest(config.existing, config.overwrite))
            sys.exit(1)


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
        note = _note(job / OUTCOME)
        outcomes[note["outcome"] if note else FAILED] += 1
        if note is None:
            lines.append(f"  {job}: ended without a word")
        elif note["outcome"] in (FAILED, UNDER_WAY):
            place = f"{note['cameras']}/{note['reward']}/seed{note['seed']}"
            why = note.get("error", "its process was killed")
            lines.append(printable(f"  {place}: {why}"))
    failed = outcomes[FAILED] + outcomes[UNDER_WAY]
    told = f"{len(jobs)} runs, {failed} failed"
    for other in (DONE_BEFORE, PAUSED, HELD):
        if outcomes[other]:
            told += f", {outcomes[other]} {other}"
    return [told, *lines], failed + outcomes[HELD]


def _note(file: Path) -> dict[str, str] | None:
    """A job's note; ``None`` where its process was killed before or while it wrote."""
    try:
        return read_json(file)
    except UnreadableError:
        return None


def rest(existing: str, overwrite: bool) -> str:
    """How to finish a sweep with these settings."""
    changes = [] if existing in RESUMING else ["with existing=resume"]
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
