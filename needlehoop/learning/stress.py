"""A stress test: the same episodes undisturbed, and under each disturbance at each severity."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from needlehoop.config.strict import check_names
from needlehoop.disturbances.axes import AXES, GROUPS, Levels, disturb_of, ladder
from needlehoop.envs.build import build
from needlehoop.envs.controllers import MakeController
from needlehoop.envs.settings import Settings
from needlehoop.learning.evaluate import wilson
from needlehoop.runs.files import ALL, NONE


@dataclass(frozen=True)
class Condition:
    """Amounts by axis, under the name of one axis or of all."""

    axis: str
    severity: int
    amounts: Mapping[str, float]


def chosen_axes(words: Iterable[str], *, blind: bool) -> list[str]:
    """Axes by their names or their groups', such as ``camera.shift`` and ``scene``; none: all.

    ``blind``: whether there are no cameras, so that only the robot can be disturbed. Raises
    ``ValueError`` for an unknown axis.
    """
    names = list(words) or (["robot"] if blind else list(GROUPS))
    check_names("axes", names, (*GROUPS, *AXES))
    axes = [key for word in names for key in AXES if word in (key, key.partition(".")[0])]
    if blind and any(not key.startswith("robot.") for key in axes):
        raise ValueError("axes: nobody looks through a camera here; choose from robot")
    return list(dict.fromkeys(axes))


def conditions(
    levels: Levels, axes: Sequence[str], severities: Iterable[int], together: int
) -> list[Condition]:
    """Undisturbed, each axis at each severity, and all of these axes at once.

    ``together``: severity of all at once. Raises ``ValueError`` for a severity or an axis that
    ``levels`` lack.
    """
    amounts, ordered = ladder(levels), sorted(set(severities))
    most = min(map(len, amounts.values())) - 1
    for severity in (*ordered, together):
        if severity > most:
            raise ValueError(f"severities, together: {severity} is not among 1 to {most}")
    single = [Condition(k, s, {k: amounts[k][s]}) for k in axes for s in ordered]
    both = Condition(ALL, together, {key: amounts[key][together] for key in axes})
    return [Condition(NONE, 0, {}), *single, both]


def stress(
    settings: Settings, make: MakeController, tried: list[Condition], episodes: int, size: int
) -> list[dict[str, Any]]:
    """A controller's results under each condition, a row each.

    Episode ``i`` begins in the same way under all of them. All share one batch of ``size``
    environments: one that is done takes the next episode that waits, of any condition. Most
    episodes end long before the time limit, so a batch for each condition would take three times
    as long. The controller must have no memory of its own.
    """
    total, task = episodes * len(tried), settings.definition
    names = (*task.columns, "return", "steps")
    table = {key: [c.amounts.get(key, 0.0) for c in tried] for key in AXES}
    most = disturb_of({key: max(values) for key, values in table.items()})
    batch = replace(settings, num_envs=min(size, total), disturb=most)
    simulation = build(batch)
    controller, here = make(simulation), simulation.device
    amounts = {key: torch.tensor(values, device=here) for key, values in table.items()}
    ended = torch.zeros(total, len(names), dtype=torch.float64, device=here)
    # The episode of each environment, counted over all conditions; -1: none is left.
    at, dealt = torch.full((batch.num_envs,), -1, device=here), 0
    fresh, moment = torch.ones(batch.num_envs, dtype=torch.bool, device=here), None
    with tqdm(total=total, desc="stress", unit="episode", disable=None) as bar:
        while True:
            rows = fresh.nonzero().flatten()
            following = dealt + torch.arange(len(rows), device=here)
            at[rows] = torch.where(following < total, following, -1)
            dealt += len(rows)
            if bool((at < 0).all()):
                break
            condition = at[rows].clamp(min=0) // episodes
            episode = at[rows].clamp(min=0) % episodes
            simulation.deal(rows, episode, {key: one[condition] for key, one in amounts.items()})
            if moment is None or len(rows):
                moment = simulation.reset(fresh)
            moment = simulation.step(controller(moment.signals))
            fresh = moment.terminated | moment.truncated
            over = fresh & (at >= 0)
            facts = (moment.facts[fact] for fact in task.columns.values())
            known = [one.double() for one in (*facts, moment.potential, moment.steps)]
            ended[at[over]] = torch.stack(known, -1)[over]
            bar.update(int(over.sum()))
    return [
        _row(condition, dict(zip(names, results.T.numpy(), strict=True)))
        for condition, results in zip(tried, ended.cpu().split(episodes), strict=True)
    ]


def _row(condition: Condition, columns: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """A line of ``stress.csv``: the condition, and rates and means over its episodes."""
    success = columns["success"]
    low, high = wilson(int(success.sum()), len(success))
    return {
        "axis": condition.axis,
        "severity": condition.severity,
        "amount": condition.amounts.get(condition.axis, ""),
        "unit": AXES[condition.axis].unit if condition.axis in AXES else "",
        "episodes": len(success),
        **{name: round(float(values.mean()), 4) for name, values in columns.items()},
        "success_low": low,
        "success_high": high,
    }


def summary(rows: list[dict[str, Any]]) -> str:
    """The rows in a few lines: undisturbed, at severity 3 the mean over axes and the worst."""
    by = {(row["axis"], row["severity"]): row for row in rows}
    severe = {axis: row for (axis, severity), row in by.items() if severity == 3 and axis in AXES}
    lines = [f"undisturbed  {by[NONE, 0]['success']:.1%}"]
    if severe:
        mean = float(np.mean([row["success"] for row in severe.values()]))
        lines.append(f"severity 3   {mean:.1%} (mean over {len(severe)} axes)")
        worst = sorted(severe.values(), key=lambda row: row["success"])[:3]
        axes = ", ".join(f"{row['axis']} {row['success']:.0%}" for row in worst)
        lines.append(f"worst        {axes}")
    lines.append(f"all at once  {rows[-1]['success']:.1%} (severity {rows[-1]['severity']})")
    return "\n".join(lines)
