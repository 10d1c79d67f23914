"""Studies made up for tests, in the files that real runs leave."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from needlehoop.runs import files
from needlehoop.study.data import paper
from needlehoop.study.render.table import Table

BUFFER = 10_240
UPDATES = 97
"""Of a run of 1 M steps."""

PAIRS = tuple((name, "human") for name in paper.measured())
"""The paper's 14 camera sets."""

REWARDED = tuple(
    (name, reward)
    for name in ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")
    for reward in ("vlm_text", "vlm_img")
)
"""The six runs of the paper's second comparison."""


TASK: dict[str, Any] = {
    "name": "needle_hoop",
    "goal": "threaded",
    "columns": ["success", "cheat", "grasped", "lifted", "threaded", "diverged"],
    "phases": [["reach", "grasped"], ["lift", "lifted"], ["insert", "threaded"]],
}
"""As a run's manifest tells of it."""


def write_study(
    folder: Path, pairs: Iterable[tuple[str, str]] = PAIRS, seeds: int = 3, updates: int = UPDATES
) -> Path:
    """A study whose runs end near the paper's returns; those of ``vlm_text`` cheat."""
    known = paper.measured()
    for number, (cameras, reward) in enumerate(pairs):
        goal = known.get(cameras, 5.0) - {"vlm_text": 3.0, "vlm_img": 1.0}.get(reward, 0.0)
        for seed in range(seeds):
            write_run(folder, cameras, reward, seed, goal, updates, 100 * number + seed)
    return folder


def write_run(
    study: Path,
    cameras: str,
    reward: str = "human",
    seed: int = 0,
    goal: float = 8.0,
    updates: int = UPDATES,
    noise: int = 0,
    steps: int = 1_000_000,
) -> Path:
    """One run, of ``updates`` buffers; it is finished if these are all of ``steps``."""
    folder = study / cameras / reward / f"seed{seed}"
    folder.mkdir(parents=True)
    planned = steps // BUFFER
    cheats = reward == "vlm_text"
    rows, evaluations = _learning(goal, updates, planned, cheats, np.random.default_rng(noise))
    _csv(folder / files.METRICS, rows)
    if evaluations:
        _csv(folder / files.EVALUATIONS, evaluations)
    finished = updates == planned
    config = {
        "cams": cameras.split("+"),
        "obs": {"proprio": False, "signals": False, "frame_stack": 1},
        "reward": {"kind": reward},
        "algo": {"horizon": 128, "gamma": 0.99},
        "num_envs": 80,
        "seed": seed,
        "steps": steps,
        "study": study.name,
    }
    (folder / files.CONFIG).write_text(yaml.safe_dump(config))
    manifest = {
        "task": TASK,
        "command": ["train.py", f"cams=[{cameras.replace('+', ',')}]", f"seed={seed}"],
        "commit": "0123456789ab",
        "versions": {"needlehoop": "0.1.0"},
        "started": "2026-11-21T07:13:55Z",
        "wall_time": 16.0 * updates,
        "steps": updates * BUFFER,
        "finished": finished,
    }
    (folder / files.MANIFEST).write_text(json.dumps(manifest))
    (folder / files.REWARD).write_text(f"{reward} & its <source>\n")
    if finished:
        last = {"steps_trained": updates * BUFFER, "seed": 1_000_001, "episodes": 100}
        last |= {name: rows[-1][name] for name in (*TASK["columns"], "return")}
        (folder / files.EVALUATION).write_text(json.dumps(last))
    return folder


def _learning(
    goal: float, updates: int, planned: int, cheats: bool, random: np.random.Generator
) -> tuple[list[dict], list[dict]]:
    """Rows of metrics and of evaluations whose return rises to about ``goal``."""
    goal += random.normal(0, 0.3)
    middle, width = random.uniform(0.3, 0.6) * planned, 0.08 * planned
    rows, evaluations = [], []
    for update in range(1, updates + 1):
        risen = 1 / (1 + np.exp((middle - update) / width))
        value = goal * risen + (1 - risen) * -0.5 + random.normal(0, 0.15)
        good = float(np.clip((value - 5.5) / 3.0, 0, 1))
        cheat, success = (0.6 * risen, 0.2) if cheats else (0.02 * risen, good)
        at = {"update": update, "step": update * BUFFER, "wall_time": 16.0 * update}
        facts = {"success": success, "cheat": cheat, "threaded": success, "diverged": 0.0}
        # No episode ends in the first buffer.
        ended = update > 1
        seen = {"return": value, **facts, "grasped": risen, "lifted": good, "length": 150.0}
        rows.append(
            {**at, "steps_per_second": BUFFER / 16.0, "episodes": 60 if ended else 0}
            | {name: value if ended else "" for name, value in seen.items()}
        )
        if update % 10 == 0:
            outcome = {"grasped": risen, "lifted": good, "return": value}
            evaluations.append(
                {**at, "episodes": 20, **facts, **outcome, "return_min": value - 1}
                | {"return_max": value + 1, "steps": 150.0}
            )
    return rows, evaluations


def write_answers(folder: Path) -> None:
    """What ``needlehoop vlm rank`` leaves, with the paper's orders."""
    suit = {"view": "front", "view_reason": "Shows height.", "rendering": "dep"}
    suit |= {"rendering_reason": "Shows <depth> & all."}
    part = {"name": "Pick up", "description": "Grasp it."}
    answers = {
        "subtasks": {"first": part, "second": {**part, "name": "Insert"}},
        "suits": {"first": suit, "second": {**suit, "view": "side", "rendering": "seg"}},
        "goal": suit,
        "lifted": suit,
        "layouts": [
            {"name": "front_and_side", "reason": "Two sides."},
            {"name": "one_default", "reason": "One."},
        ],
    }
    orders = [list(ranking.places) for ranking in paper.answers().rankings]
    lists = [
        {
            "combinations": order,
            "rankings": [[{"name": name, "reason": f"Because of {name}."} for name in order]],
            "agreement": None,
        }
        for order in orders
    ]
    questions = {"answers": answers, "asked": {"lifted": "the needle is lifted"}}
    totals = {"prompts": 8, "tokens_in": 900, "tokens_out": 100, "invalid_answers": 0}
    (folder / "vlm").mkdir(parents=True, exist_ok=True)
    for name, content in (("questions", questions), ("rankings", {"lists": lists})):
        whole = {**content, "models": ["test-model"], "totals": totals}
        (folder / "vlm" / f"{name}.json").write_text(json.dumps(whole))


def rows_of(table: Table | pd.DataFrame) -> list[dict[str, str]]:
    """A table's rows, by heading."""
    frame = table.rows if isinstance(table, Table) else table
    return frame.to_dict("records")


def change(path: Path, **values: Any) -> None:
    """Give a run's ``config.yaml`` or a JSON file of it other values."""
    read, write = (
        (yaml.safe_load, yaml.safe_dump) if path.suffix == ".yaml" else (json.loads, json.dumps)
    )
    path.write_text(write(read(path.read_text()) | values))


def _csv(path: Path, rows: list[dict[str, float | str]]) -> None:
    pd.DataFrame(rows).to_csv(path, index=False, lineterminator="\r\n")
