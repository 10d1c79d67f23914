"""Where a study stands: what is done, running, stopped, failed or missing; the time left."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median, mode

from needlehoop.runs import files
from needlehoop.study.data.records import Place, Record, Study
from needlehoop.study.render.table import Table, written

STATES = DONE, RUNNING, STOPPED, FAILED, MISSING = "done", "running", "stopped", "failed", "missing"

_QUIET = 600.0
"""Seconds without a sign of life after which an unfinished run counts as stopped."""

_RECENT = 5
"""Buffers over which a run's rate is taken."""

Ends = Mapping[Place, tuple[float, str | None]]
"""By run, when a sweep's job ended (Unix time, s), and why it failed, if it did."""


@dataclass(frozen=True)
class Standing:
    """One run, begun or expected."""

    place: Place
    state: str
    done: float
    """Share of its steps."""
    rate: float | None
    """Environment steps per second, evaluations on the way included."""
    left: float | None
    """Seconds; of a run that is not begun, at the other runs' rate; ``None``: unknown."""
    error: str | None
    """Why it failed."""


def read_job_ends(study: Path) -> Ends:
    """The newest end of each run that sweeps have tried for a study."""
    notes = (study.resolve().parent / files.SWEEPS).glob(f"*/*/{files.OUTCOME}")
    ends: dict[Place, tuple[float, str | None]] = {}
    for when, path in sorted((path.stat().st_mtime, path) for path in notes):
        note = json.loads(path.read_text(encoding="utf-8"))
        if note["study"] == study.resolve().name:
            place = Place(note["cameras"], note["reward"], note["seed"])
            ends[place] = when, note.get("error")
    return ends


def standings(study: Study, ends: Ends) -> list[Standing]:
    """The state of each run, in the order of places.

    Expected is every pair of cameras and reward in the study with every seed that any has, and what
    sweeps have tried. A run has failed if a sweep noted so after the last sign of life in its
    files. It is stopped if its manifest says so, or if nothing in its folder has changed for ten
    minutes (or for five buffers, if that is longer): killed, or gone with its machine.
    """
    runs = {run.place: run for run in study.runs}
    seeds = {place.seed for place in runs}
    expected = {replace(place, seed=seed) for place, seed in product(runs, seeds)} | ends.keys()
    rates = {run.place: rate for run in study.runs if (rate := _rate(run))}
    usual = median(rates.values()) if rates else None
    plan = mode(run.planned_steps for run in study.runs) if runs else 0
    entries = []
    for place in sorted(expected):
        run, (ended, error) = runs.get(place), ends.get(place, (0.0, None))
        state, steps, planned = MISSING, 0, plan
        if run is not None:
            error = error if ended >= _last_sign(run) and not run.finished else None
            state, steps, planned = _state(run, rates.get(place)), run.steps, run.planned_steps
        pace = rates.get(place, usual)
        left = 0.0 if state == DONE else (planned - steps) / pace if pace and planned else None
        done = steps / planned if planned else 0.0
        state = FAILED if error else state
        entries.append(Standing(place, state, done, rates.get(place), left, error))
    return entries


def describe(runs: list[Standing], study: Study) -> str:
    """The standings as a table of text, with the sums below."""
    rows = [
        {
            "run": str(run.place),
            "state": run.state,
            "steps": f"{run.done:.0%}",
            "steps/s": written(run.rate, ".0f"),
            "time left": "" if run.state == DONE else _duration(run.left),
        }
        for run in runs
    ]
    lines = [Table.of("status", str(study.folder), rows).text()] if rows else [f"{study.folder}:"]
    counts = Counter(run.state for run in runs)
    tally = ", ".join(f"{counts[state]} {state}" for state in STATES)
    if left := [run.left for run in runs if run.state != DONE]:
        # Side by side as now.
        together = max(1, counts[RUNNING])
        total = None if None in left else sum(filter(None, left)) / together
        tally += f"; {_duration(total)} of training left with {together} at a time"
    else:
        tally += "; nothing left to do"
    lines.append(tally)
    lines += [f"{run.state}: {run.place}: {run.error}" for run in runs if run.error]
    return "\n".join([*lines, *(f"left out: {reason}" for reason in study.left_out)])


def _duration(seconds: float | None) -> str:
    """Seconds as ``2 h 05 min``."""
    if seconds is None:
        return "unknown"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def _last_sign(run: Record) -> float:
    """Unix time at which one of the run's files was last changed, s."""
    names = (files.CONFIG, files.MANIFEST, files.METRICS, files.EVALUATIONS)
    paths = [run.folder / name for name in names]
    return max(path.stat().st_mtime for path in paths if path.exists())


def _state(run: Record, rate: float | None) -> str:
    """The state by the run's own files, without those of sweeps."""
    if run.finished:
        return DONE
    seen = _last_sign(run)
    # A run that goes on writes other files before its manifest.
    if run.manifest.get("stopped") and (run.folder / files.MANIFEST).stat().st_mtime >= seen:
        return STOPPED
    patience = max(_QUIET, 5 * run.buffer / rate) if rate else _QUIET
    return RUNNING if time.time() - seen <= patience else STOPPED


def _rate(run: Record) -> float | None:
    """Steps per second over the last buffers; ``None`` before there are two."""
    if run.metrics is None or len(run.metrics) < 2:
        return None
    steps, seconds = run.metrics[["step", "wall_time"]].iloc[-_RECENT - 1 :].to_numpy().T
    return float((steps[-1] - steps[0]) / (seconds[-1] - seconds[0]))
