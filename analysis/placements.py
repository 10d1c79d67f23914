"""Q3 of docs/protocol.md: where to put a camera. Rules and rankings against training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from analysis.protocol import means
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.rollout import rollout
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.study.render.table import Cell, Column, Estimated, Table
from needlehoop.study.stats.statistics import Interval

_EPISODES, _EVERY = 10, 5
"""Episodes of the expert in which pixels are counted, and steps from one picture to the next."""

_DRAWS, _RESAMPLES = 10_000, 2_000
_FAR = 10.0
"""Where things are put that are not to be seen, m."""

ELEVATION, PIXELS, HIDDEN = "elevation nearest 45°", "most pixels", "least hidden"


def settings_of(cameras: str) -> Settings:
    """The wide task, seen through one of the drawn cameras."""
    return compose_settings(
        ["+experiment=placements", "task=wide", f"cams=[{cameras}]", f"num_envs={_EPISODES}"]
    )


def rules(cameras: list[str]) -> pd.DataFrame:
    """Scores of single cameras by the three rules, higher is better; a row for each camera."""
    rows = {}
    for name in cameras:
        settings = settings_of(name)
        view = settings.views[name.partition("_")[2]]
        seen, alone = _pixels(settings)
        rows[name] = {
            ELEVATION: -abs(view.elevation - 45.0),
            PIXELS: float(seen),
            HIDDEN: seen / alone,
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def _pixels(settings: Settings) -> tuple[int, int]:
    """Pixels of needle and hoop while the expert does the task: as seen, and with nothing else
    in the scene."""
    (view,) = {name.partition("_")[2] for name in settings.cams}
    simulation, _ = build(replace(settings, cams=(f"seg_{view}",)))
    model = simulation.engine.model
    wanted = np.array(
        [model.geom(i).name.startswith(("needle", "hoop")) for i in range(model.ngeom)]
    )

    def alone(fields: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        places = fields["geom_xpos"].copy()
        places[:, ~wanted] += _FAR
        return {**fields, "geom_xpos": places}

    totals = np.zeros(2, dtype=int)
    for number, step in enumerate(rollout(simulation, controller("expert", settings))):
        if number % _EVERY:
            continue
        for k, optics in enumerate((None, alone)):
            geoms = simulation.engine.render(optics=optics)[view].geom
            assert geoms is not None
            shown = geoms.numpy()[step.alive.numpy()]
            totals[k] += int(wanted[shown[shown >= 0]].sum())
    return int(totals[0]), int(totals[1])


def foretold_table(scores: pd.DataFrame, runs: pd.DataFrame) -> Table:
    """Spearman's ρ of each prediction (a column of ``scores``) with mean success by camera set."""
    measured = means(runs)
    names = [name for name in scores.index if name in measured]
    truth = np.array([measured[name] for name in names])
    draw = np.random.default_rng(0)
    rows: list[tuple[Cell, ...]] = []
    for who in scores:
        own = scores.loc[names, who].to_numpy(float)
        shuffled = draw.permuted(np.tile(own, (_DRAWS, 1)), axis=1)
        (rho,) = _rho(own[None], truth[None])
        chance = (1 + np.sum(_rho(shuffled, truth[None]) >= rho - 1e-9)) / (1 + _DRAWS)
        lost = float(truth.max() - truth[own == own.max()].mean())
        ends = _bootstrap(own, runs, names)
        rows.append((str(who), Estimated(float(rho), ends), float(chance), lost))
    rows.append(("drawn blindly", None, None, float(truth.max() - truth.mean())))
    columns = (
        Column("prediction"), Column("ρ (95 %)", form=".2f"), Column("p", form="p"),
        Column("regret", "points", ".0f", 100.0),
    )  # fmt: skip
    return Table("placements", "", columns, tuple(rows))


def _rho(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Spearman's ρ of rows ``(k, n)``: ``(k,)``; NaN where a row is all on one level."""
    a, b = (rankdata(one, axis=1) - (one.shape[1] + 1) / 2 for one in (a, b))
    with np.errstate(invalid="ignore"):
        return (a * b).sum(1) / np.sqrt((a**2).sum(1) * (b**2).sum(1))


def _bootstrap(own: np.ndarray, runs: pd.DataFrame, names: list[str]) -> Interval:
    """Cameras drawn anew, and the runs of each."""
    draw = np.random.default_rng(1)
    groups = [runs[runs["cameras"] == name]["success"].to_numpy() for name in names]
    drawn = np.stack([draw.choice(one, (_RESAMPLES, len(one))).mean(1) for one in groups], 1)
    picked = draw.integers(len(names), size=drawn.shape)
    found = _rho(own[picked], np.take_along_axis(drawn, picked, 1))
    low, high = np.nanpercentile(found, (2.5, 97.5))
    return Interval(float(low), float(high))
