"""Studies, or single runs, beside each other: what differs, how far each came, their films."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from needlehoop.study.data.paper import reward_label
from needlehoop.study.data.records import Record, Study
from needlehoop.study.render.curves import count_steps, draw_panels
from needlehoop.study.render.style import in_percent, new_figure, short
from needlehoop.study.render.table import Column, Row, Table
from needlehoop.study.stats.findings import Result, result_of
from needlehoop.study.stats.run import (
    BUFFERS,
    CHEAT,
    RETURN,
    SUCCESS,
    Measure,
    has_curve,
    share_at,
    smooth,
    steps_to_share,
)
from needlehoop.study.stats.statistics import (
    OVER_EPISODES,
    OVER_SEEDS,
    Estimated,
    Interval,
    SeedEstimate,
    difference,
)

_HALF = {"half": 0.5}
_MILESTONES = {"a tenth": 0.1, **_HALF, "95 %": 0.95}
"""Shares of training episodes in which the task is done."""

_WHICH = ("study", "results", "until", "existing", "overwrite", "resume", "engine.threads")
"""Settings that say which run it is and how it was run, not what was trained."""

_MILLIONS = Column("", "M steps", ".2f", 1e-6)


@dataclass(frozen=True)
class Comparison:
    """Studies' runs with the same cameras and reward; or single runs with any."""

    runs: Mapping[str, tuple[Record, ...]]
    """By study or run, in the order in which they were named."""

    @property
    def every(self) -> list[Record]:
        return [run for runs in self.runs.values() for run in runs]

    @property
    def title(self) -> str:
        """Their cameras and rewards."""
        cameras = dict.fromkeys(run.place.cameras for run in self.every)
        rewards = dict.fromkeys(reward_label(run.place.reward) for run in self.every)
        return f"{' / '.join(cameras)}, {' / '.join(rewards)}"

    @property
    def file(self) -> str:
        """The same, for the name of a file."""
        cameras = dict.fromkeys(run.place.cameras for run in self.every)
        rewards = dict.fromkeys(run.place.reward for run in self.every)
        return f"{'_vs_'.join(cameras)}_{'_vs_'.join(rewards)}"

    @property
    def steps(self) -> int:
        """Environment steps that all runs have."""
        return min(run.steps for run in self.every)


def comparisons(studies: Sequence[Study]) -> list[Comparison]:
    """Each camera set and reward that two of the studies or more have been trained with.

    Raises:
        ValueError: fewer than two studies, two of one name, or nothing in common.
    """
    names = [study.folder.resolve().name for study in studies]
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
    shared = [Comparison(found[place]) for place in sorted(found) if len(found[place]) > 1]
    if not shared:
        trained = "".join(
            f"\n  {'/'.join(place)}: {', '.join(own)}" for place, own in found.items()
        )
        raise ValueError(f"studies: no cameras and reward that two of them have{trained}")
    return shared


def compared_runs(runs: Sequence[Record]) -> Comparison:
    """Runs beside each other, named by what differs in their paths.

    Raises:
        ValueError: fewer than two, one twice, or one without a learning curve.
    """
    places = [run.folder.resolve() for run in runs]
    if len({*places}) < max(len(places), 2):
        raise ValueError(f"runs: {', '.join(map(str, places))}; name two or more, each once")
    for run in runs:
        if not has_curve(run):
            raise ValueError(f"{run.folder}: no episode has ended yet")
    rows = [place.parts for place in places]
    if len({*map(len, rows)}) == 1:
        odd = [i for i, parts in enumerate(zip(*rows, strict=True)) if len({*parts}) > 1]
        rows = [tuple(row[i] for i in odd) for row in rows]
    names = ("/".join(row) for row in rows)
    return Comparison({name: (run,) for name, run in zip(names, runs, strict=True)})


def outcomes(found: Sequence[Comparison], of: str) -> Table:
    """Final values, and how far each ``study`` or ``run`` (``of``) is from the first named."""
    rows: list[Row] = []
    for one in found:
        first: dict[Measure, SeedEstimate] = {}
        for name, runs in one.runs.items():
            result = result_of(runs)
            own = _measured(result) if result else {}
            first = first or own
            # Points of another reward are not compared.
            same = runs[0].place.reward == one.every[0].place.reward
            success = own.get(SUCCESS)
            rows.append(
                {
                    **_place_of(runs[0]),
                    Column(of): name,
                    Column("runs"): result and len(result.runs),
                    Column("episodes"): result and sum(end.episodes for end in result.finals),
                    **_beside(SUCCESS, success, first.get(SUCCESS)),
                    Column.of(CHEAT): result and result.cheat and result.cheat.value,
                    **_beside(RETURN, own.get(RETURN), first.get(RETURN) if same else None),
                    Column("intervals"): success and success.interval and success.interval.over,
                }
            )
    note = (
        f"Differences are from the {of} that stands first for these cameras and this reward, in"
        " points of percent and of return, with 95 % intervals; returns of another reward are not"
        " compared. An interval without 0 is a difference. One over episodes says nothing of"
        " what another seed would give."
    )
    return Table.of("evaluations", "Evaluations", rows, note)


def _place_of(run: Record) -> Row:
    return {
        Column("cameras"): run.place.cameras,
        Column("reward"): reward_label(run.place.reward),
    }


def _beside(measure: Measure, own: SeedEstimate | None, first: SeedEstimate | None) -> Row:
    """A value, and how far it is from the first named's."""
    column, beyond = Column.of(measure), None
    if own is not None and first is not None and own is not first:
        beyond = _shown(own.value - first.value, difference(first, own))
    less = replace(column, name=f"difference of {column.name}", form=f"+{column.form}")
    return {column: own and _shown(own.value, own.interval), less: beyond}


def progress(found: Sequence[Comparison], of: str = "study") -> Table:
    """How soon each run got how far, and where all were after the same steps."""
    every = [run for one in found for run in one.every]
    goals, facts = {run.task.goal for run in every}, _facts(every)
    milestones = {
        replace(_MILLIONS, name=f"{said} {fact}"): (fact, share)
        for fact in facts
        for said, share in (_MILESTONES if fact in goals else _HALF).items()
    }
    rows: list[Row] = [
        {
            **_place_of(run),
            Column(of): study,
            Column("seed"): run.place.seed,
            **{column: steps_to_share(run, *stone) for column, stone in milestones.items()},
            replace(_MILLIONS, name="compared after"): one.steps,
            **{Column.share(fact): _at(run, fact, one.steps) for fact in facts},
            Column.of(RETURN): _at(run, "return", one.steps),
        }
        for one in found
        for study, runs in one.runs.items()
        for run in runs
    ]
    note = (
        f"Of training episodes, over {BUFFERS} buffers. Milestones: millions of steps until they"
        " were reached; empty where they were not. The last columns: after as many steps as all"
        " runs of the same cameras and reward have. A return is in its own reward's points."
    )
    return Table.of("progress", "Progress in training", rows, note)


def differences(found: Sequence[Comparison], of: str = "study") -> Table:
    """Settings and commits in which the studies or runs differ; seeds where they are runs."""
    hidden = {*_WHICH, *(["seed"] if of == "study" else [])}
    names = dict.fromkeys(name for one in found for name in one.runs)
    rows: list[Row] = []
    settings = {
        name: [
            {**run.settings, "commit": str(run.manifest.get("commit", ""))}
            for one in found
            for run in one.runs.get(name, ())
        ]
        for name in names
    }
    every = {key for own in settings.values() for one in own for key in one}
    for key in sorted(every - hidden):
        # Where runs of a study differ among themselves, all its values.
        told = [dict.fromkeys(one[key] for one in own if key in one) for own in settings.values()]
        line = [" / ".join(values) if values else None for values in told]
        if len({*line}) > 1:
            cells = map(_brief, (key, *line))
            rows.append(dict(zip(map(Column, ("setting", *names)), cells, strict=True)))
    note = "Empty: a setting that did not exist when the run was made."
    return Table.of("settings", "What differs", rows, note)


def comparison_chart(one: Comparison) -> Figure:
    """How far episodes come, and the return, over training; a line for each study."""
    runs = one.every
    # The facts that end the last two phases.
    shown = {fact: f"share {fact}" for fact in _facts(runs)[-2:]} | {"return": "return"}
    drawn = [column for column in shown if all(column in (run.metrics or ()) for run in runs)]
    figure, grid = new_figure(12 + 40 * len(drawn), len(drawn), sharex=True)
    lines = [(short(name), own, number) for number, (name, own) in enumerate(one.runs.items())]
    for axes, column in zip(grid[:, 0], drawn, strict=True):
        if column != "return":
            in_percent(axes, room=0.03)
        words = f"{shown[column]} in training"
        draw_panels([axes], [("", lines)], partial(smooth, column=column), words, named=True)
    grid[0, 0].set_title(short(one.title))
    count_steps(grid[-1, 0])
    return figure


def _shown(value: float, interval: Interval | None) -> Estimated:
    """What an interval is over stands in a column of its own."""
    return Estimated(value, interval and replace(interval, over=OVER_SEEDS))


def _measured(result: Result) -> dict[Measure, SeedEstimate]:
    """Final success and return; the return of one run has an interval over its episodes."""
    success, value, (run, *others) = result.success, result.value, result.runs
    spread = (run.evaluation or {}).get("return_sd")
    if not others and run.finished and isinstance(spread, int | float):
        half = 1.96 * float(spread) / math.sqrt(result.finals[0].episodes)
        ends = Interval(value.value - half, value.value + half, OVER_EPISODES)
        value = replace(value, interval=ends)
    return {RETURN: value} | ({SUCCESS: success} if success else {})


def _brief(value: str | None) -> str | None:
    """A setting, or of a program how long it is."""
    return f"{value.count(chr(10))} lines" if value and "\n" in value else value


def _facts(runs: Sequence[Record]) -> list[str]:
    """Those that end the runs' phases, and the tasks' goals."""
    ends = [fact for run in runs for _, fact in run.task.phases]
    return [*dict.fromkeys([*ends, *(run.task.goal for run in runs)])]


def _at(run: Record, column: str, steps: int) -> float | None:
    value = float(share_at(run, np.array([float(steps)]), column)[0])
    return None if np.isnan(value) else value
