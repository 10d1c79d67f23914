"""The protocol's runs as tables: a row for each run, and one for each condition of its stress test.

``python -m analysis.runs results/protocol <study folder> …`` adds the finished runs of studies to
``runs.csv`` and ``stress.csv`` of a folder. A run that is there already stays as it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from needlehoop.runs.files import NONE, STRESS
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.study.data.records import Record, read_study
from needlehoop.study.stats.run import TRAINING, final

RUN = ["disturb", "cameras", "reward", "seed"]
"""What tells runs apart: what they were trained under, see and were paid for, and their seed."""

DISTURB = CONF / "disturb"
"""Options of what runs are trained under."""

_SHARES = ("success", "grasped", "lifted", "touched", "cheat", "return", "return_human")
"""Of an evaluation, those that its task has."""

RUNS = "runs.csv"


def is_two_sided(cameras: str) -> bool:
    """Whether a camera set has a front and a side view."""
    return {"front", "side"} <= {camera.partition("_")[2] for camera in cameras.split("+")}


def add(to: Path, studies: Sequence[Path]) -> None:
    """Add the finished runs of studies to a folder's tables.

    ``ValueError``: a run was trained under amounts that no option of ``disturb`` has.
    """
    records = [run for folder in studies for run in read_study(folder).runs if run.finished]
    for name, rows_of in ((RUNS, _run), (STRESS, _stress)):
        path = to / name
        old = [pd.read_csv(path)] if path.exists() else []
        new = [pd.DataFrame(rows) for run in records if (rows := rows_of(run))]
        if not old + new:
            continue
        rows = pd.concat(old + new, ignore_index=True)
        key = [column for column in (*RUN, "axis", "severity") if column in rows]
        rows = rows.drop_duplicates(key).sort_values(RUN, kind="stable")
        path.parent.mkdir(parents=True, exist_ok=True)
        rows.to_csv(path, index=False, float_format="%.5g")


def _key(run: Record) -> dict[str, Any]:
    options = {path.stem: read_yaml(path) for path in DISTURB.glob("*.yaml")}
    names = [name for name, amounts in options.items() if amounts == run.config["disturb"]]
    if not names:
        raise ValueError(f"{run.folder}: its disturb is none of {', '.join(sorted(options))}")
    return {"disturb": names[0]} | asdict(run.place)


def _run(run: Record) -> list[dict[str, Any]]:
    evaluation, end = run.evaluation, final(run)
    assert evaluation is not None
    assert end is not None
    shares = {name: evaluation[name] for name in _SHARES if name in evaluation}
    return [
        _key(run)
        | {"commit": run.manifest["commit"], "minutes": run.manifest["wall_time"] / 60}
        | {"steps": evaluation["steps_trained"], "sampled": evaluation["success_sampled"], **shares}
        | {"over_training": end.measures.get(TRAINING)}
    ]


def _stress(run: Record) -> list[dict[str, Any]]:
    if run.stress is None:
        return []
    conditions = run.stress[["axis", "severity", "episodes", "success"]].itertuples(index=False)
    return [_key(run) | row._asdict() for row in conditions]


def runs_of(folder: Path) -> pd.DataFrame:
    """A row for each run that was trained undisturbed, with the traits of its camera set.

    A seed counts once all camera sets have it with all rewards, so that all of them are measured on
    the same seeds.
    """
    runs = pd.read_csv(folder / RUNS)
    runs = _complete(runs.query(f"disturb == '{NONE}'"), len({*_compared(runs)}))
    sets = runs["cameras"]
    runs["two_views"] = sets.map(is_two_sided)
    runs["depth"] = sets.str.contains(r"(?:^|\+)(?:seg)?dep_")
    runs["labels"] = sets.str.contains(r"(?:^|\+)seg")
    return runs


def stress_of(folder: Path) -> pd.DataFrame:
    """A row for each condition of each stress test, of seeds for which all sets were tested."""
    groups = pd.read_csv(folder / STRESS).groupby("disturb", sort=False)
    sets = len({*_compared(pd.read_csv(folder / RUNS))})
    tables = [_complete(group, sets) for _, group in groups]
    return pd.concat(tables, ignore_index=True)


def _complete(rows: pd.DataFrame, sets: int) -> pd.DataFrame:
    by_seed = _compared(rows).groupby(rows["seed"]).transform("nunique")
    return rows.loc[by_seed == sets].reset_index(drop=True)


def _compared(rows: pd.DataFrame) -> pd.Series:
    return rows["cameras"].str.cat(rows["reward"], " ")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m analysis.runs")
    parser.add_argument("to", type=Path, help="folder of the tables")
    parser.add_argument("studies", type=Path, nargs="+", help="folders of studies")
    options = parser.parse_args()
    try:
        add(options.to, options.studies)
    except ValueError as error:
        parser.error(str(error))
