"""Studies, or single runs, beside each other: what differs, how far each came, their films."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from needlehoop.study.data.paper import reward_label
from needlehoop.study.data.records import Record, Study
from needlehoop.study.render.figures import Drawn, draw_panels
from needlehoop.study.render.style import new_figure, save, short, styled
from needlehoop.study.render.table import Table, written
from needlehoop.study.report.page import Agent, Section, film_of, write_page
from needlehoop.study.report.tables import RESULTS_NOTE, TO_SOON, result_row
from needlehoop.study.stats.findings import Result, result_of
from needlehoop.study.stats.run import TRAINING, has_curve, smooth
from needlehoop.study.stats.statistics import Estimated, Interval, difference

Comparison = Mapping[str, Sequence[Record]]
"""What stands beside each other: runs by their study's name, or each by a name of its own."""

_WHICH = ("study", "results", "until", "existing", "overwrite", "resume", "engine.threads")
"""Settings that say which run it is and how it was run, not what was trained."""

_SHOWN = ("cameras", "reward", "seeds", "success, %", "success, 95 %", "cheat, %", "return",
          TRAINING, TO_SOON)  # fmt: skip
"""Of a result's columns."""


def comparisons(studies: Sequence[Study]) -> list[Comparison]:
    """Each camera set and reward that two of the studies or more have been trained with."""
    names = [study.folder.resolve().name for study in studies]
    if len({*names}) < max(len(names), 2):
        raise ValueError(f"studies: {', '.join(names)}; name two or more, of different names")
    runs: dict[tuple[str, str], dict[str, list[Record]]] = {}
    for name, study in zip(names, studies, strict=True):
        for run in filter(has_curve, study.runs):
            place = (run.place.cameras, run.place.reward)
            runs.setdefault(place, {}).setdefault(name, []).append(run)
    shared: list[Comparison] = [runs[place] for place in sorted(runs) if len(runs[place]) > 1]
    if not shared:
        trained = (f"\n  {'/'.join(place)}: {', '.join(group)}" for place, group in runs.items())
        raise ValueError(f"studies: no cameras and reward that two of them have{''.join(trained)}")
    return shared


def compared_runs(runs: Sequence[Record]) -> Comparison:
    """Runs beside each other, named by what differs in their paths."""
    folders = [run.folder.resolve() for run in runs]
    if len({*folders}) < max(len(folders), 2):
        raise ValueError(f"runs: {', '.join(map(str, folders))}; name two or more, each once")
    if empty := [str(run.folder) for run in runs if not has_curve(run)]:
        raise ValueError(f"{empty[0]}: no episode has ended yet")
    parts = [folder.parts for folder in folders]
    odd = [i for i, level in enumerate(zip(*parts, strict=False)) if len({*level}) > 1]
    names = ("/".join(path[i] for i in odd) for path in parts)
    return {name: [run] for name, run in zip(names, runs, strict=True)}


def outcomes(groups: Sequence[Comparison], of: str) -> Table:
    """Results, and how far each ``study`` or ``run`` (``of``) is from the first named."""
    rows = []
    for group in groups:
        results = {name: result for name, runs in group.items() if (result := result_of(runs))}
        first = next(iter(results.values()), None)
        for name, result in results.items():
            row = {of: name, "difference of success, %": "", "difference of return": ""}
            if first is not None and result is not first:
                less = difference(first.success, result.success)
                row["difference of success, %"] = written(less, "+.0f", 100.0)
                # Points of another reward are not compared.
                if result.reward == first.reward:
                    less = difference(_value(first), _value(result))
                    row["difference of return"] = written(less, "+.2f")
            cells = result_row(result)
            rows.append(row | {key: cells[key] for key in _SHOWN})
    note = (
        f"Differences are from the {of} that stands first for these cameras and this reward, in"
        " points of percent and of return, with 95 % intervals. " + RESULTS_NOTE
    )
    return Table.of("evaluations", "Evaluations", rows, note)


def _value(result: Result) -> Estimated:
    """The final return; that of one run has an interval over its episodes."""
    value, evaluation = result.value, result.runs[0].evaluation or {}
    if len(result.runs) > 1 or result.unfinished or "return_sd" not in evaluation:
        return value
    half = 1.96 * float(evaluation["return_sd"]) / math.sqrt(evaluation["episodes"])
    return replace(value, interval=Interval(value.value - half, value.value + half))


def differences(groups: Sequence[Comparison]) -> Table:
    """Settings and commits in which the studies or runs differ."""
    rows = []
    for key, run in ((key, run) for group in groups for key, runs in group.items() for run in runs):
        config = pd.json_normalize({**run.config, "commit": run.manifest.get("commit")}).iloc[0]
        rows.append(config.drop([*_WHICH], errors="ignore").map(_as_text).rename(key))
    # Where runs of a study differ among themselves, all its values.
    by_name = pd.DataFrame(rows).groupby(level=0, sort=False)
    settings = by_name.agg(lambda values: " / ".join(values.dropna().unique())).T.sort_index()
    differing = settings[settings.nunique(axis=1) > 1].rename_axis("setting").reset_index()
    note = "Empty: a setting that did not exist when the run was made."
    return Table.of("settings", "What differs", differing.to_dict("records"), note)


def _as_text(value: Any) -> str:
    """A setting; a program is shown by its length."""
    lines = str(value).count("\n")
    return f"{lines} lines" if lines else str(value)


def comparison_chart(group: Comparison) -> Figure:
    """How far episodes come, and the return, over training; a line for each study."""
    every = [run for runs in group.values() for run in runs]
    # The facts that end the last two phases.
    columns = [*(fact for _, fact in every[0].task.phases[-2:]), "return"]
    figure, grid = new_figure(12 + 40 * len(columns), len(columns), sharex=True)
    lines = [(short(name), runs, number) for number, (name, runs) in enumerate(group.items())]
    for axes, column in zip(grid[:, 0], columns, strict=True):
        words = f"{column} in training"
        draw_panels([axes], [("", lines)], partial(smooth, column=column), words, named=True)
    return figure


def write_comparison(groups: Sequence[Comparison], of: str, out: Path, command: str) -> list[Table]:
    """Write tables, charts and ``comparison.html`` into a folder; returns the tables."""
    tables = [differences(groups), outcomes(groups, of)]
    for table in tables:
        table.write(out)
    sections = [Section("Tables", tables=tables)]
    for group in groups:
        places = [run.place for runs in group.values() for run in runs]
        name = "_vs_".join(dict.fromkeys(f"{place.cameras}_{place.reward}" for place in places))
        title = " / ".join(dict.fromkeys(f"{p.cameras}, {reward_label(p.reward)}" for p in places))
        with styled():
            chart = Drawn(name, "Learning curves.", save(comparison_chart(group), out / name))
        films = [Agent(key, film=film) for key, runs in group.items() if (film := film_of(runs))]
        commands = "\n".join(run.command for runs in group.values() for run in runs)
        sections.append(Section(title, figures=[chart], agents=films, text=commands))
    names = dict.fromkeys(name for group in groups for name in group)
    write_page(out / "comparison.html", " and ".join(names), sections, command)
    return tables
