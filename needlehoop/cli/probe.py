"""``needlehoop probe``."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import add_command
from needlehoop.config import strict

if TYPE_CHECKING:
    from needlehoop.envs.settings import Settings
    from needlehoop.probe.plan import Grid, Plan
    from needlehoop.probe.scores import ProbeResults
    from needlehoop.scene.cameras import View


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    command = add_command(
        commands,
        "probe",
        _probe,
        "Rank cameras by what can be read off their images, without training a policy. What is"
        " measured is shown; compute=true measures the rest, and goes on where it was stopped.",
        "cams=rgb_front,dep_front+seg_side seeds=2 episodes.train=300 fit.updates=400 study=probe"
        " compute=false overwrite=false grid.rendering=rgb grid.azimuths=[-60,0,60]",
    )
    command.add_argument(
        "--grid", choices=("views",), help="score a grid of azimuths and elevations, and map it"
    )


def _probe(options: argparse.Namespace) -> int:
    values = _values(options.overrides)
    from needlehoop.envs.settings import settings_from

    standing = settings_from({**values, "cams": []})
    from needlehoop.probe.folder import Folder
    from needlehoop.probe.measuring import missing, probe
    from needlehoop.probe.plan import Grid
    from needlehoop.probe.report import PHASES_TABLE, all_tables

    views = strict.as_type(values["grid"], Grid, "grid")
    grid = views if options.grid else None
    plan = _plan(values, standing, grid)
    asked, place = plan.asked, Path(plan.results) / plan.study
    if grid:
        place /= f"views_{grid.rendering}"
    flags = ["--grid", options.grid] if options.grid else []
    lacking = sum(map(len, missing(plan, place).values()))
    if lacking and not strict.value(values, "compute", bool):
        words = " ".join(["needlehoop", "probe", *flags, *options.overrides])
        raise ValueError(
            f"compute: {place} lacks {lacking} measurements; `{words}"
            f" compute=true` makes them, in about {_minutes(plan, lacking)} on two cores"
        )
    command = ["needlehoop", "probe", *flags, *options.overrides]
    folder = Folder(place, asked, _noted(values, standing, grid), plan.overwrite, command)
    try:
        probe(plan, folder)
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130
    results = folder.results(plan.seeds)
    for table in all_tables(results):
        table.write(folder.path)
        # Hundreds of rows are for files.
        if table.name != PHASES_TABLE:
            print(table.text())
    _draw(results, folder.path, grid, standing.views)
    print(f"files        {folder.path}")
    return 0


def _minutes(plan: Plan, measurements: int) -> str:
    """The time that measurements take: 36 of 400 updates took 12 min 20 s on a 2-core EPYC VM."""
    minutes = measurements * plan.fit.updates * 740 / (36 * 400) / 60
    return f"{minutes:.0f} minutes" if minutes >= 1.5 else "a minute"


def _values(overrides: list[str]) -> dict[str, Any]:
    """The composed config; its ``cams`` are camera sets.

    Hydra knows ``cams`` as the options of one environment, so they go by another name there.
    """
    from needlehoop.config import composing

    words = [re.sub("^cams=", "combinations=", word) for word in composing.in_brackets(overrides)]
    values = composing.compose(words, "probe")
    values["cams"] = values.pop("combinations")
    return values


def _plan(values: dict[str, Any], standing: Settings, grid: Grid | None) -> Plan:
    from needlehoop.learning.job import PpoConfig
    from needlehoop.probe.plan import Plan, camera_sets

    settings, given = standing, values["cams"]
    if grid:
        settings = replace(standing, views=grid.views(standing.views))
        given = [f"{grid.rendering}_{name}" for name in grid.names().values()]
    heads = strict.as_type(values["algo"], PpoConfig, "algo").network
    sets = camera_sets(given, settings)
    return strict.as_type({**values, "env": settings, "camera_sets": sets, "heads": heads}, Plan)


def _noted(values: dict[str, Any], standing: Settings, grid: Grid | None) -> dict[str, Any]:
    """Settings that the probe may depend on; what the task decides is written out."""
    without = {"algo", "compute", "num_envs", "obs", "overwrite", "picture", "reward", "seed"}
    own = {key: value for key, value in values.items() if key not in without}
    if not grid:
        del own["grid"]
    network = dict(values["algo"]["network"])
    if network["told"] is None:
        network["told"] = standing.definition.critic
    renderings = {name: asdict(one) for name, one in standing.renderings.items()}
    # Lists, as YAML has them.
    return json.loads(json.dumps({**own, "renderings": renderings, "network": network}))


def _draw(
    results: ProbeResults, folder: Path, grid: Grid | None, standing: Mapping[str, View]
) -> None:
    """The figure: the ranking, or the map of a grid."""
    from needlehoop.probe.report import ranking_figure, view_map
    from needlehoop.study.render.style import save, styled

    with styled():
        if not grid:
            save(ranking_figure(results), folder / "ranking")
            return
        scores = {
            at: results.score(f"{grid.rendering}_{name}").value for at, name in grid.names().items()
        }
        what = f"score of one {grid.rendering} camera"
        figure = view_map(scores, grid.azimuths, grid.elevations, standing, what)
        save(figure, folder / "map")
