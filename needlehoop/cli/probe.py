"""``needlehoop probe``: what can be read off cameras' images."""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import KEYS, argument, command
from needlehoop.config import strict

if TYPE_CHECKING:
    from needlehoop.envs.settings import Settings
    from needlehoop.probe.plan import Grid, Plan


@command(
    KEYS,
    argument(
        "--grid", choices=("views",), help="score a grid of azimuths and elevations, and map it"
    ),
    config="probe",
    goes_on=True,
)
def probe(options: argparse.Namespace) -> None:
    """Rank cameras by what can be read off their images, without training a policy.

    What is measured is shown; compute=true measures the rest, and goes on where it was stopped.
    Camera sets are given as cams=rgb_front,dep_front+seg_side.
    """
    from needlehoop.config import composing

    # Hydra knows cams as the options of one environment, so camera sets go by another name there.
    words = composing.in_brackets(options.overrides)
    values = composing.compose((re.sub("^cams=", "combinations=", w) for w in words), "probe")
    from needlehoop.envs.settings import settings_from

    standing = settings_from({**values, "cams": []})
    from needlehoop.probe import measuring
    from needlehoop.probe.folder import Folder
    from needlehoop.probe.frames import quantities
    from needlehoop.probe.plan import Grid
    from needlehoop.probe.report import all_tables, ranking_figure, view_map
    from needlehoop.study.render.style import save, styled

    views = strict.value(values, "grid", Grid)
    grid = views if options.grid else None
    plan = _plan(values, standing, grid)
    place = Path(plan.results) / plan.study
    place = place / f"views_{grid.rendering}" if grid else place
    lacking = sum(map(len, measuring.missing(plan, place).values()))
    if lacking and not strict.value(values, "compute", bool):
        raise ValueError(
            f"compute: {place} lacks {lacking} measurements; the same command with compute=true"
            " makes them"
        )
    flags = ["--grid", options.grid] if options.grid else []
    typed = ["needlehoop", "probe", *flags, *options.overrides]
    noted = _noted(values, standing, grid)
    folder = Folder(place, quantities(standing.definition), noted, plan.overwrite, typed)
    measuring.probe(plan, folder)
    results = folder.results(plan.seeds)
    for table in all_tables(results):
        table.write(place)
        # Hundreds of rows are for files.
        if table.name != "phases":
            print(table.text())
    with styled():
        if grid:
            save(view_map(results, grid, standing.views), place / "map")
        else:
            save(ranking_figure(results), place / "ranking")
    print(f"files        {place}")


def _plan(values: dict[str, Any], standing: Settings, grid: Grid | None) -> Plan:
    from needlehoop.learning.algorithm_config import PpoConfig
    from needlehoop.probe.plan import Plan, camera_sets

    settings, given = standing, values["combinations"]
    if grid:
        views = grid.views(standing.views)
        settings = replace(standing, views=views)
        given = [f"{grid.rendering}_{name}" for name in views]
    heads = strict.value(values, "algo", PpoConfig).network
    sets = camera_sets(given, settings)
    return strict.as_type({**values, "env": settings, "camera_sets": sets, "heads": heads}, Plan)


def _noted(values: dict[str, Any], standing: Settings, grid: Grid | None) -> dict[str, Any]:
    """Settings that the probe may depend on; what the task decides is written out."""
    without = {"algo", "compute", "num_envs", "obs", "overwrite", "picture", "reward", "seed"}
    without |= set() if grid else {"grid"}
    own = {key: value for key, value in values.items() if key not in without}
    own["cams"] = own.pop("combinations")
    network = dict(values["algo"]["network"])
    if network["told"] is None:
        network["told"] = standing.definition.critic
    renderings = {name: asdict(one) for name, one in standing.renderings.items()}
    # Lists, as YAML has them.
    return json.loads(json.dumps({**own, "renderings": renderings, "network": network}))
