"""``needlehoop probe``: what can be read off cameras' images."""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path

import yaml

from needlehoop.cli.command import KEYS, command
from needlehoop.config import composing, strict
from needlehoop.runs.files import CONFIG, new_folder, seen, write_whole
from needlehoop.runs.machine import provenance


@command(KEYS, config="probe")
def probe(options: argparse.Namespace) -> None:
    """Rank cameras by what can be read off their images, without training a policy.

    What is measured is shown; compute=true measures, into a new folder. Camera sets are given as
    cams=rgb_front,dep_front+seg_side.
    """
    # Hydra knows cams as the options of one environment, so camera sets go by another name there.
    words = (re.sub("^cams=", "combinations=", word) for word in options.overrides)
    values = composing.compose(words, "probe")
    from needlehoop.envs.settings import settings_from

    standing = settings_from({**values, "cams": []})
    from needlehoop.probe import measuring, report, scores
    from needlehoop.probe.frames import quantities
    from needlehoop.probe.measuring import Plan, camera_sets
    from needlehoop.runs.run import Run

    sets = camera_sets(values["combinations"], standing)
    plan = strict.as_type({**values, "env": standing, "camera_sets": sets}, Plan)
    place = Path(plan.results) / plan.study
    if strict.value(values, "compute", bool):
        with new_folder(place, strict.value(values, "overwrite", bool)) as folder:
            write_whole(folder / CONFIG, yaml.safe_dump(values, sort_keys=False))
            began = time.perf_counter()
            measuring.probe(plan, folder)
            typed, took = ["needlehoop", "probe", *options.overrides], time.perf_counter() - began
            Run(folder).note(**provenance(), command=typed, wall_time=round(took, 1))
    lacking = [seen(cams) for cams in sets if not (place / f"seed0/{seen(cams)}.csv").is_file()]
    if lacking:
        raise ValueError(
            f"compute: {place} lacks {lacking[0]}; compute=true measures all of these camera sets"
            " into a new study="
        )
    results = scores.load(place, quantities(standing.definition))
    print(report.write(results, place))
    print(f"files        {place}")
