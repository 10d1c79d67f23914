"""Studies beside each other: the same cameras and reward under other settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from needlehoop.study.data.paper import reward_label
from needlehoop.study.data.records import Record, Study
from needlehoop.study.render.curves import MissingDataError, draw_line, name_ends
from needlehoop.study.render.style import new_figure, short
from needlehoop.study.render.table import Column, Table
from needlehoop.study.stats.run import (
    BUFFERS,
    grid_of,
    has_curve,
    share_at,
    smooth,
    steps_to_share,
)

_HALF = {"half": 0.5}
_MILESTONES = {"a tenth": 0.1, **_HALF, "95 %": 0.95}
"""Shares of training episodes in which the task is done."""

_PANELS = 2
"""Facts in a chart: those that end the last phases."""

_WHICH = ("study", "seed", "results", "until", "existing", "overwrite", "resume", "engine.threads")
"""Settings that say which run it is and how it was run, not what was trained."""


@dataclass(frozen=True)
class Comparison:
    """Runs with the same cameras and reward."""

    cameras: str
    reward: str
    runs: Mapping[str, tuple[Record, ...]]
    """By study, in the order in which they were named."""

    @property
    def steps(self) -> int:
        """Environment steps that all runs have."""
        return min(run.steps for runs in self.runs.values() for run in runs)


def comparisons(studies: Sequence[Study]) -> list[Comparison]:
    """Each camera set and reward that two of the studies or more have been trained with.

    Raises:
        ValueError: fewer than two studies, two of one name, or nothing in common.
    """
    names = [_name(study) for study in studies]
    if len(studies) < 2:
        raise ValueError(f"studies: {', '.join(names)} alone; name two or more")
    if len({*names}) < len(names):
        raise ValueError(f"studies: {', '.join(names)} are not different names")
    found: dict[tuple[str, str], dict[str, tuple[Record, ...]]] = {}
    for name, study in zip(names, studies, strict=True):
        for run in study.runs:
            if has_curve(run):
                own = found.setdefault((run.place.cameras, run.place.reward), {})
                own[name] = (*own.get(name, ()), run)
    shared = [Comparison(*place, found[place]) for place in sorted(found) if len(found[place]) > 1]
    if not shared:
        trained = "".join(
            f"\n  {'/'.join(place)}: {', '.join(own)}" for place, own in found.items()
        )
        raise ValueError(f"studies: no cameras and reward that two of them have{trained}")
    return shared


def progress(found: Sequence[Comparison]) -> Table:
    """How soon each run got how far, and where all were after the same steps."""
    every = [run for one in found for runs in one.runs.values() for run in runs]
    goals, facts = {run.task.goal for run in every}, _facts(every)
    milestones = {
        f"{said} {fact}": (fact, share)
        for fact in facts
        for said, share in (_MILESTONES if fact in goals else _HALF).items()
    }
    rows = []
    for one in found:
        for study, runs in one.runs.items():
            for run in runs:
                rows.append(
                    (
                        one.cameras,
                        reward_label(one.reward),
                        study,
                        run.place.seed,
                        *(_steps_to(run, *stone) for stone in milestones.values()),
                        one.steps,
                        *(_at(run, column, one.steps) for column in (*facts, "return")),
                    )
                )
    millions = {"unit": "M steps", "form": ".2f", "scale": 1e-6}
    columns = (
        *map(Column, ("cameras", "reward", "study", "seed")),
        *(Column(name, **millions) for name in (*milestones, "compared after")),
        *map(Column.share, facts),
        Column("return", form=".2f"),
    )
    note = (
        f"Of training episodes, over {BUFFERS} buffers. Milestones: millions of steps until they"
        " were reached; empty where they were not. The last columns: after as many steps as all"
        " runs of the same cameras and reward have. A return is in its own reward's points."
    )
    return Table("progress", "Progress in training", columns, tuple(rows), note)


def differences(found: Sequence[Comparison]) -> Table:
    """Settings and commits in which the studies differ."""
    runs: dict[str, list[Record]] = {}
    for one in found:
        for study, own in one.runs.items():
            runs.setdefault(study, []).extend(own)
    values = {study: _values(own) for study, own in runs.items()}
    keys = sorted({key for own in values.values() for key in own})
    lines = [(key, *(own.get(key) for own in values.values())) for key in keys]
    rows = tuple(line for line in lines if len({*line[1:]}) > 1)
    note = "Empty: a setting that did not exist when the run was made."
    return Table("settings", "What differs", tuple(map(Column, ("setting", *values))), rows, note)


def comparison_chart(one: Comparison) -> Figure:
    """How far episodes come, and the return, over training; a line for each study."""
    runs = [run for own in one.runs.values() for run in own]
    steps = grid_of(runs)
    longest = steps[-1]
    shown = {fact: f"share {fact}" for fact in _facts(runs)[-_PANELS:]} | {"return": "return"}
    drawn = {column: text for column, text in shown.items() if all(_has(r, column) for r in runs)}
    if not drawn:
        raise MissingDataError("no learning curves")
    figure, grid = new_figure(12 + 40 * len(drawn), len(drawn), sharex=True)
    ends = []
    for axes, (column, text) in zip(grid[:, 0], drawn.items(), strict=True):
        axes.set_ylabel(f"{text} in training")
        axes.grid(axis="y", linewidth=0.3)
        axes.set_xlim(0, longest / 1e6)
        lines = []
        for number, (study, own) in enumerate(one.runs.items()):
            curves = np.array([smooth(run, column, steps) for run in own])
            lines.append(draw_line(axes, steps, number, short(study), curves))
        ends.append(lines)
    grid[0, 0].set_title(short(f"{one.cameras}, {reward_label(one.reward)}"))
    grid[-1, 0].set_xlabel("environment steps, millions")
    name_ends(figure, grid[:, 0], ends, longest)
    return figure


def _name(study: Study) -> str:
    return study.folder.resolve().name


def _facts(runs: Sequence[Record]) -> list[str]:
    """Those that end the runs' phases, and the tasks' goals."""
    ends = [fact for run in runs for _, fact in run.task.phases]
    return [*dict.fromkeys([*ends, *(run.task.goal for run in runs)])]


def _has(run: Record, column: str) -> bool:
    return run.metrics is not None and column in run.metrics.columns


def _steps_to(run: Record, column: str, share: float) -> float | None:
    return steps_to_share(run, column, share) if _has(run, column) else None


def _at(run: Record, column: str, steps: int) -> float | None:
    if not _has(run, column):
        return None
    value = float(share_at(run, column, np.array([float(steps)]))[0])
    return None if np.isnan(value) else value


def _values(runs: Sequence[Record]) -> dict[str, str]:
    """Each setting of a study's runs; where they differ among themselves, all its values."""
    found: dict[str, dict[str, None]] = {}
    for run in runs:
        settings = {**run.settings, "commit": str(run.manifest.get("commit", ""))}
        for key, value in settings.items():
            if key not in _WHICH:
                found.setdefault(key, {})[value] = None
    return {key: " / ".join(own) for key, own in found.items()}
