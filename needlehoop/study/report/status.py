"""Where a study stands: what is done, running, stopped, failed or missing; the time left."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median, mode

from needlehoop.runs import files
from needlehoop.runs.reading import UnreadableError, read_json
from needlehoop.study.data.contents import checked
from needlehoop.study.data.records import LeftOut, Place, Record, Study
from needlehoop.study.render.table import Column, Row, Table

STATES = DONE, RUNNING, STOPPED, FAILED, MISSING = "done", "running", "stopped", "failed", "missing"
OTHER = "other"
"""A run that stands there with other settings than those that are asked for."""

_QUIET = 600.0
"""Seconds without a sign of life after which an unfinished run counts as stopped."""

_RECENT = 5
"""Buffers over which a run's rate is taken."""


@dataclass(frozen=True)
class Standing:
    """One run, begun or expected."""

    place: Place
    state: str
    steps: int
    planned: int | None
    """Steps; ``None`` where no run says how many."""
    rate: float | None
    """Environment steps per second, evaluations on the way included."""
    left: float | None
    """Seconds; of a run that is not begun, at the other runs' rate; ``None``: unknown."""
    silent: float | None
    """Seconds since one of its files changed; ``None`` for a run that is not begun."""
    error: str | None
    """Why it failed, or which of its settings are others."""


@dataclass(frozen=True)
class _Note:
    """What a sweep's job leaves."""

    study: str
    cameras: str
    reward: str
    seed: int
    outcome: str
    error: str | None = None


def read_job_ends(study: Path) -> tuple[dict[Place, tuple[float, str | None]], list[LeftOut]]:
    """The newest end of each run that sweeps have tried for a study, which may have no folder yet.

    Returns:
        By run, when it ended (Unix time, s) and why it failed, if it did; then the notes that
        cannot be read.
    """
    root = study.resolve().parent / files.SWEEPS
    found: dict[Place, tuple[float, str | None]] = {}
    left_out: list[LeftOut] = []
    # The newest comes last.
    notes = root.glob(f"*/*/{files.OUTCOME}")
    for when, path in sorted((one.lstat().st_mtime, one) for one in notes):
        try:
            note: _Note = checked(_Note, read_json(path))
        except UnreadableError as error:
            left_out.append(LeftOut(Path("..") / path.relative_to(root.parent), str(error)))
            continue
        if note.study == study.resolve().name:
            found[Place(note.cameras, note.reward, note.seed)] = when, note.error
    return found, left_out


def standings(
    study: Study,
    ends: Mapping[Place, tuple[float, str | None]],
    expected: Mapping[Place, Mapping[str, str]] | None = None,
) -> list[Standing]:
    """The state of each run, in the order of places.

    A run has failed if a sweep noted so after the last sign of life in its files. It is
    stopped if its manifest says so, or if nothing in its folder has changed for ten minutes
    (or for five buffers, if that is longer): killed, or gone with its machine.

    Args:
        study: as read from its folder.
        ends: of the jobs of sweeps, as ``read_job_ends`` gives them.
        expected: the runs that are asked for, with the settings that they are to have. By default,
            with any: every pair of cameras and reward in the study with every seed that any has,
            and those that sweeps have tried.
    """
    now = time.time()
    runs = {run.place: run for run in study.runs}
    if expected is None:
        pairs = {(run.place.cameras, run.place.reward) for run in study.runs}
        seeds = {run.place.seed for run in study.runs}
        places = {Place(*pair, seed) for pair, seed in product(pairs, seeds)}
        expected = {place: {} for place in places | ends.keys()}
    rates = [rate for run in study.runs if (rate := _rate(run)) is not None]
    usual = median(rates) if rates else None
    plan = mode(run.planned_steps for run in study.runs) if study.runs else None
    found = []
    for place, asked in sorted(expected.items()):
        run, (ended, error) = runs.get(place), ends.get(place, (0.0, None))
        other = _other(run, asked) if run else None
        if run is None or other:
            steps = int(asked["steps"]) if "steps" in asked else plan
            left = steps / usual if steps is not None and usual else None
            state = OTHER if other else FAILED if error else MISSING
            found.append(Standing(place, state, 0, steps, None, left, None, other or error))
            continue
        seen, rate = _last_sign(run), _rate(run)
        if ended < seen or run.finished:
            error = None
        state, pace = FAILED if error else _state(run, now - seen, rate), rate or usual
        rest = 0 if state == DONE else max(run.planned_steps - run.steps, 0)
        left = 0.0 if not rest else rest / pace if pace else None
        found.append(
            Standing(place, state, run.steps, run.planned_steps, rate, left, now - seen, error)
        )
    return found


def describe(found: list[Standing], study: Study) -> str:
    """The standings as a table of text, with the sums below."""
    if not found:
        return "\n".join((f"{study.folder}: no runs", *map(str, study.left_out)))
    rows: list[Row] = []
    for one in found:
        open_, silent = one.state != DONE, one.silent
        rows.append(
            {
                Column("run"): str(one.place),
                Column("state"): one.state,
                Column("steps", form=".0%"): one.steps / one.planned if one.planned else None,
                Column("steps/s", form=".0f"): one.rate,
                Column("time left"): duration(one.left) if open_ else None,
                Column("last sign"): (
                    f"{duration(silent)} ago" if open_ and silent is not None else None
                ),
            }
        )
    lines = [Table.of("status", str(study.folder), rows).text()]
    counts = Counter(one.state for one in found)
    tally = ", ".join(f"{counts[state]} {state}" for state in STATES)
    tally += f", {counts[OTHER]} with other settings" if counts[OTHER] else ""
    lines += [f"{tally}; {time_left(found)}"]
    lines += [f"{one.state}: {one.place}: {one.error}" for one in found if one.error]
    others = len({run.place for run in study.runs} - {one.place for one in found})
    if others:
        lines.append(f"{others} other runs are in {study.folder}")
    if study.left_out:
        lines += [f"left out: {len(study.left_out)}", *(f"  {one}" for one in study.left_out)]
    return "\n".join(lines)


def _other(run: Record, asked: Mapping[str, str]) -> str | None:
    """Which of a run's settings are not those that are asked for."""
    own = run.settings
    odd = [key for key, text in asked.items() if not _are_same(own.get(key, ""), text)]
    return "; ".join(f"{key}={own.get(key)}, not {asked[key]}" for key in odd) or None


def _are_same(one: str, other: str) -> bool:
    """Whether two settings are the same text, or the same number."""
    try:
        return float(one) == float(other)
    except ValueError:
        return one == other


def time_left(found: list[Standing]) -> str:
    """The work left, one run after the other and side by side as now."""
    open_ = [one for one in found if one.state != DONE]
    if not open_:
        return "nothing left to do"
    known = [one.left for one in open_ if one.left is not None]
    if len(known) < len(open_):
        return "time left unknown: no run has a rate yet"
    side_by_side = max(1, sum(one.state == RUNNING for one in open_))
    return (
        f"{duration(sum(known) / side_by_side)} left with {side_by_side} at a time"
        " (training only; the last evaluation and film come on top)"
    )


def duration(seconds: float | None) -> str:
    """Seconds as ``2 h 05 min``."""
    if seconds is None:
        return "unknown"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"


def _last_sign(run: Record, *names: str) -> float:
    """Unix time at which one of these files, or any, of the run was last changed, s; 0: none."""
    names = names or (files.CONFIG, files.MANIFEST, files.METRICS, files.EVALUATIONS)
    paths = [run.folder / name for name in names]
    return max((path.stat().st_mtime for path in paths if path.exists()), default=0.0)


def _state(run: Record, silent: float, rate: float | None) -> str:
    if run.finished:
        return DONE
    # A run that goes on writes other files before its manifest.
    if run.stopped and _last_sign(run, files.MANIFEST) >= _last_sign(run):
        return STOPPED
    patience = max(_QUIET, 5 * run.buffer / rate) if rate else _QUIET
    return RUNNING if silent <= patience else STOPPED


def _rate(run: Record) -> float | None:
    """Steps per second over the last buffers; ``None`` before there are any."""
    if run.metrics is None:
        return None
    steps, seconds = run.metrics["step"], run.metrics["wall_time"]
    first = max(len(steps) - 1 - _RECENT, 0)
    # The first buffer has no row before it: it began at nothing.
    begun = (steps[first], seconds[first]) if len(steps) > 1 else (0.0, 0.0)
    spent = seconds[-1] - begun[1]
    return float((steps[-1] - begun[0]) / spent) if spent > 0 and steps[-1] > begun[0] else None
