"""Sweeps: what became of each run, and how many CPUs it may use."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback

from needlehoop.engines.cpu import available_cpus

OUTCOME = "outcome.json"
"""In the folder that Hydra makes for each job of a sweep."""

STOPPED, FAILED = "stopped", "failed"


def attempt(run: Callable[[], str], folder: Path, overrides: list[str]) -> None:
    """Do one run of a sweep and note what became of it; a failure does not stop the others.

    Somebody who stopped the run stops the sweep.

    Args:
        run: does it; returns what became of it in a word, such as ``done``.
        folder: the job's own.
        overrides: what makes this run differ from the others.
    """
    note = {"run": " ".join(overrides)}
    try:
        note["outcome"] = run()
        if note["outcome"] == STOPPED:
            raise KeyboardInterrupt
    except Exception as error:
        # Whatever it is: the next run may do better, and the summary says what this one did.
        traceback.print_exc()
        note |= {"outcome": FAILED, "error": f"{type(error).__name__}: {error}"}
    (folder / OUTCOME).write_text(json.dumps(note, indent=2) + "\n")


class Summary(Callback):
    """Says at a sweep's end what failed; the exit status is then 1."""

    def on_multirun_end(self, config: Any, **kwargs: Any) -> None:
        """Called by Hydra where the sweep was started."""
        told = summary(Path(config.hydra.sweep.dir))
        print(told.text)
        if told.failed:
            sys.exit(1)


class Told:
    """A sweep's end in words.

    Args:
        notes: what was noted of each job.
        silent: folders of jobs that noted nothing.
    """

    def __init__(self, notes: list[dict[str, str]], silent: list[Path]):
        self.failed = len(silent) + sum(note["outcome"] == FAILED for note in notes)
        lines = [f"{len(notes) + len(silent)} runs, {self.failed} failed"]
        lines += [
            f"  {note['run']}: {note['error']}" for note in notes if note["outcome"] == FAILED
        ]
        lines += [f"  {folder}: ended without a word" for folder in silent]
        if self.failed:
            lines.append("the same command does what is missing")
        self.text = "\n".join(lines)


def summary(folder: Path) -> Told:
    """What became of the jobs whose folders are in a sweep's."""
    jobs = [job for job in folder.iterdir() if job.name.isdigit()]
    jobs.sort(key=lambda job: int(job.name))
    files = [job / OUTCOME for job in jobs]
    notes = [json.loads(file.read_text()) for file in files if file.exists()]
    return Told(notes, [file.parent for file in files if not file.exists()])


def threads(launcher: Mapping[str, Any]) -> int:
    """Threads for each of a launcher's jobs, so that they do not crowd each other.

    Args:
        launcher: Hydra's config of it.

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
