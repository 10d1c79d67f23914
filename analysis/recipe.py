"""Q9 of docs/protocol.md: of each four programs, the one that is trained to the end.

``python -m analysis.recipe results/recipe <study folder>`` measures agents after 150,000 steps,
adds them to ``programs.csv``, and prints how the kept ones go on. A program that is in the table
already stays as it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from needlehoop.learning.evaluate import evaluate, load_agent
from needlehoop.learning.subject import flown_job
from needlehoop.runs.run import Run
from needlehoop.study.data.records import Record, read_study

TRIED, LAST, PROGRAMS = 150_000, 50_000, 4
"""Steps of every program, those over which lifts count, and programs of a repetition."""

TIED = 0.01
"""Programs whose shares of lifts are closer than this are tied."""

EPISODES, TABLE = 300, "programs.csv"


def lifted(metrics: pd.DataFrame) -> float:
    """Share of the episodes in which the sampled policy lifts, over the last steps of a trial."""
    rows = metrics[(metrics["step"] > metrics["step"].max() - LAST) & (metrics["episodes"] > 0)]
    return float(np.average(rows["lifted"], weights=rows["episodes"]))


def kept(programs: pd.DataFrame) -> int:
    """Which sample of a repetition goes on: most lifts, then the human reward's highest return."""
    tied = programs[programs["lifted"] > programs["lifted"].max() - TIED]
    return int(tied.loc[tied["return_human"].idxmax(), "sample"])


def _trial(run: Record) -> dict[str, Any]:
    """An agent that stands at the end of its trial; ``ValueError`` for any other."""
    metrics = run.metrics
    if metrics is None or not TRIED <= run.steps < TRIED + run.buffer:
        raise ValueError(f"{run.folder} stands at {run.steps} steps, not {TRIED}")
    job, _ = flown_job(run.config, (), trust=False)
    agent = load_agent(Run.open(run.folder), job, torch.device("cpu"))
    # Episodes that it was not trained on, as in its final evaluation.
    settings = replace(job.env, seed=job.evaluation.final_seed)
    outcome = evaluate(settings, agent, EPISODES, sampled=True).summary()
    reward: Mapping[str, Any] = run.config["reward"]
    return {
        "repetition": (reward["sample"] - 1) // PROGRAMS + 1,
        "sample": reward["sample"],
        "seed": run.place.seed,
        "commit": run.manifest["commit"],
        "lifted": lifted(metrics),
        "return_human": outcome["return_human"],
    }


def add(to: Path, study: Path) -> tuple[pd.DataFrame, dict[int, Path]]:
    """Add a study's programs to the table in the folder ``to``.

    Returns the table, a row for each program, and the runs' folders by sample.
    """
    path = to / TABLE
    old = [pd.read_csv(path)] if path.exists() else []
    known = {sample for table in old for sample in table["sample"]}
    runs = {run.config["reward"]["sample"]: run for run in read_study(study).runs}
    new = [pd.DataFrame([_trial(run)]) for sample, run in runs.items() if sample not in known]
    table = pd.concat(old + new).sort_values("sample", ignore_index=True)
    to.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.5g")
    return table, {sample: run.folder for sample, run in runs.items()}


def main(to: Path, study: Path) -> None:
    """Measure, and print the table and the commands that go on."""
    table, folders = add(to, study)
    print(table.to_string(index=False))
    for _, group in table.groupby("repetition"):
        if len(group) == PROGRAMS:
            print(f"python train.py resume={folders[kept(group)]}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m analysis.recipe")
    parser.add_argument("to", type=Path, help="folder of the table")
    parser.add_argument("study", type=Path, help="folder of the study")
    options = parser.parse_args()
    main(options.to, options.study)
