"""A stress test: the same episodes undisturbed, and under each disturbance at each severity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from needlehoop.disturbances.axes import AXES, GROUPS, amount_at, disturb_of
from needlehoop.envs.build import build
from needlehoop.envs.rollout import MakeController
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.learning.evaluate import wilson

NONE, ALL = "none", "all"
"""Names of the conditions without a disturbance, and with every axis at once."""

Levels = Mapping[str, Mapping[str, tuple[float, ...]]]
"""Amounts at severities 1, 2, … by axis, by group: ``conf/levels``."""


@dataclass(frozen=True)
class Condition:
    """Amounts by axis, under a name."""

    axis: str
    severity: int
    amounts: Mapping[str, float]


def check_levels(levels: Levels) -> None:
    """Raises ``ValueError`` unless each axis has an amount for each severity."""
    counts = {f"{g}.{name}": len(own) for g, axes in levels.items() for name, own in axes.items()}
    for key in counts.keys() ^ AXES.keys():
        raise ValueError(f"levels.{key}: {'missing' if key in AXES else 'no such axis'}")
    if len(set(counts.values())) != 1:
        raise ValueError("levels: every axis needs as many severities as the others")


def chosen_axes(words: Iterable[str], *, blind: bool) -> list[str]:
    """Axes by their names or their groups'; all by default.

    Args:
        words: names of axes or groups, such as ``camera.shift`` and ``scene``.
        blind: whether whoever acts has no cameras: then only the robot can be disturbed.

    Raises:
        ValueError: no such axis.
    """
    given = list(words) or (["robot"] if blind else list(GROUPS))
    found = []
    for word in given:
        own = [key for key in AXES if word in (key, key.partition(".")[0])]
        if not own:
            raise ValueError(
                f"axes: {word!r} is unknown; choose from {', '.join((*GROUPS, *AXES))}"
            )
        found += own
    if blind and any(not key.startswith("robot.") for key in found):
        raise ValueError("axes: nobody looks through a camera here; choose from robot")
    return list(dict.fromkeys(found))


def conditions(
    levels: Levels, axes: Iterable[str], severities: Iterable[int], together: int = 3
) -> list[Condition]:
    """Undisturbed, each axis at each severity, and all of these axes at once.

    Args:
        axes: as from ``chosen_axes``.
        together: severity of all at once.

    Raises:
        ValueError: there is no such severity.
    """
    check_levels(levels)
    chosen, most = list(axes), len(next(iter(next(iter(levels.values())).values())))
    for severity in severities:
        if not 1 <= severity <= most:
            raise ValueError(f"severities: {severity} is not among 1 to {most}")

    return [
        Condition(NONE, 0, {}),
        *(
            Condition(k, s, {k: amount_at(levels, k, s)})
            for k in chosen
            for s in sorted(set(severities))
        ),
        Condition(ALL, together, {key: amount_at(levels, key, together) for key in chosen}),
    ]


def stress(
    settings: Settings,
    make: MakeController,
    tried: list[Condition],
    episodes: int,
    size: int = 100,
) -> list[dict[str, Any]]:
    """What comes of a controller under each condition, a row each.

    Episode ``i`` begins in the same way under all of them. All share one batch: an environment
    that is done takes the next episode that waits, of whatever condition.

    Args:
        settings: environment with the seed of the episodes; it is itself undisturbed.
        make: makes the controller, which has no memory of its own.
        tried: the conditions.
        episodes: of each.
        size: environments side by side.
    """
    n = min(size, episodes * len(tried))
    most = {key: max(c.amounts.get(key, 0.0) for c in tried) for key in AXES}
    own = replace(
        settings,
        num_envs=n,
        disturb=disturb_of({key: amount for key, amount in most.items() if amount}),
    )
    simulation, _ = build(own)
    controller = make(simulation)
    task = settings.definition
    ended = np.zeros((len(tried), episodes, len(task.columns) + 2))
    jobs = np.ndindex(len(tried), episodes)
    at: list[tuple[int, int] | None] = [None] * n
    fresh, moment = torch.ones(n, dtype=torch.bool), None
    with tqdm(total=ended[..., 0].size, desc="stress", unit="episode", disable=None) as bar:
        while True:
            _deal(simulation, tried, jobs, at, fresh)
            if all(one is None for one in at):
                break
            if moment is None or bool(fresh.any()):
                moment = simulation.reset(fresh)
            moment = simulation.step(controller(moment.signals))
            fresh = moment.terminated | moment.truncated
            for env in fresh.nonzero().flatten().tolist():
                if (job := at[env]) is not None:
                    facts = [float(moment.facts[fact][env]) for fact in task.columns.values()]
                    ended[job] = (*facts, moment.potential[env], moment.steps[env])
                    bar.update()
    names = (*task.columns, "return", "steps")
    return [
        _row(condition, dict(zip(names, found.T, strict=True)))
        for condition, found in zip(tried, ended, strict=True)
    ]


def _deal(
    simulation: Simulation,
    tried: list[Condition],
    jobs: Iterator[tuple[int, ...]],
    at: list[tuple[int, int] | None],
    fresh: torch.Tensor,
) -> None:
    """Give the environments that are done what waits; the last ones get nothing."""
    rows = fresh.nonzero().flatten()
    for env in rows.tolist():
        job = next(jobs, None)
        at[env] = None if job is None else (job[0], job[1])
    given = [at[env] or (0, 0) for env in rows.tolist()]
    amounts = {
        key: torch.tensor([tried[c].amounts.get(key, 0.0) for c, _ in given]) for key in AXES
    }
    simulation.deal(rows, torch.tensor([episode for _, episode in given]), amounts)


def _row(condition: Condition, found: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """A line of ``stress.csv``: the condition, and rates and means over its episodes."""
    success = found["success"]
    low, high = wilson(int(success.sum()), len(success))
    amount = condition.amounts.get(condition.axis)
    unit = AXES[condition.axis].unit if condition.axis in AXES else ""
    return {
        "axis": condition.axis,
        "severity": condition.severity,
        "amount": "" if amount is None else amount,
        "unit": unit,
        "episodes": len(success),
        **{name: round(float(values.mean()), 4) for name, values in found.items()},
        "success_low": low,
        "success_high": high,
    }


def summary(rows: list[dict[str, Any]], severity: int = 3) -> str:
    """The rows in a few lines: undisturbed, the mean over axes, the worst of them."""
    by = {(row["axis"], row["severity"]): row for row in rows}
    own = {axis: row for (axis, s), row in by.items() if s == severity and axis in AXES}
    lines = [f"undisturbed  {by[NONE, 0]['success']:.1%}"]
    if own:
        mean = float(np.mean([row["success"] for row in own.values()]))
        lines.append(f"severity {severity}   {mean:.1%} (mean over {len(own)} axes)")
        worst = sorted(own.values(), key=lambda row: row["success"])[:3]
        told = ", ".join(f"{row['axis']} {row['success']:.0%}" for row in worst)
        lines.append(f"worst        {told}")
    together = next(row for row in rows if row["axis"] == ALL)
    lines.append(f"all at once  {together['success']:.1%} (severity {together['severity']})")
    return "\n".join(lines)
