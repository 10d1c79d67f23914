"""Commands that show the scene or a controller: ``needlehoop snapshot``, ``expert``, …"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from needlehoop.cli.command import add_command, environment, new_file
from needlehoop.config import strict
from needlehoop.config.strict import Amount, Count, Pixels

Levels = dict[str, dict[str, tuple[Amount, ...]]]
"""Amounts at severities 1, 2, … by axis, by group: ``conf/levels``."""


def add_commands(commands: Any) -> None:
    """Add the commands to the subparsers of ``needlehoop``."""
    add = partial(add_command, commands)
    add(
        "snapshot",
        _snapshot,
        "Write a contact sheet of all views and renderings, start and goal.",
        "size=256 out=snapshot.png raw=false tiles=false disturbed=false overwrite=false",
    )
    add(
        "picture",
        _picture,
        "Write one large picture of the start, from any place.",
        "size=720 out=picture.png overwrite=false picture.distance=1.6 picture.azimuth=60 …",
    )
    run = add(
        "expert",
        _expert,
        "Run a scripted controller and print what came of it.",
        "episodes=200 controller=expert|smooth|cheat|random grasps=[weld,friction]"
        " (or episode.grasp=…) video_episodes=3 overwrite=false",
    )
    run.add_argument("--json", action="store_true", help="print one line of JSON")
    run.add_argument("--video", type=Path, metavar="OUT.mp4", help="also write a video")
    add(
        "view",
        _view,
        "Watch in MuJoCo's interactive viewer.",
        "controller=expert|smooth|cheat|random",
    )
    add("signals", _signals, "Print the table of a task's signals.", "none of its own")
    summary = "List the tasks: their facts, phases, controllers and variants."
    listed = commands.add_parser("tasks", help=summary, description=summary)
    listed.add_argument(
        "overrides", nargs="*", metavar="key=value", help="task_dir=<folder> conf_dir=<folder>"
    )
    listed.set_defaults(run=_tasks)


def _snapshot(options: argparse.Namespace) -> None:
    settings, values = environment(options, "snapshot")
    asked = strict.read(
        values, out=str, overwrite=bool, size=Pixels, tiles=bool, raw=bool, disturbed=bool
    )
    if asked.tiles:
        if Path(asked.out).suffix:
            raise ValueError(f"out: {asked.out!r}; tiles=true writes a folder")
        folder = new_file(asked.out, "", asked.overwrite)
        from needlehoop.pictures.stills import tiles

        for name, image in tiles(settings).items():
            _save(image, folder / f"{name}.png")
        return
    out = new_file(asked.out, ".png", asked.overwrite)
    if asked.disturbed:
        from needlehoop.pictures.disturbed import disturbed_sheet

        levels = strict.value(values, "levels", Levels)
        _save(disturbed_sheet(settings, levels, asked.size), out)
        return
    from needlehoop.pictures.stills import contact_sheet

    _save(contact_sheet(settings, asked.size, asked.raw), out)


def _picture(options: argparse.Namespace) -> None:
    settings, values = environment(options, "picture")
    asked = strict.read(values, out=str, overwrite=bool, size=Pixels)
    out = new_file(asked.out, ".png", asked.overwrite)
    from needlehoop.pictures.stills import portrait

    _save(portrait(settings, asked.size), out)


def _save(image: Any, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    image.save(out)
    print(f"{out}: {image.width} x {image.height} px")


def _expert(options: argparse.Namespace) -> None:
    settings, values = environment(options, "expert")
    asked = strict.read(
        values, controller=str, episodes=Count, video_episodes=Count, overwrite=bool
    )
    who, grasps = asked.controller, _grasps(values, options)
    if options.video is not None:
        new_file(options.video, ".mp4", asked.overwrite, "--video")
    from needlehoop.envs.controllers import run_trials
    from needlehoop.tasks.episode import ArmEpisode

    summaries = {}
    for grasp in grasps if isinstance(settings.episode, ArmEpisode) else ("episodes",):
        tried = settings
        if isinstance(settings.episode, ArmEpisode):
            tried = replace(settings, episode=replace(settings.episode, grasp=grasp))
        summaries[grasp] = run_trials(tried, who, asked.episodes).summary()
    if options.json:
        print(json.dumps({"controller": who, "seed": settings.seed, **summaries}))
    else:
        _print_table(f"{who}, {asked.episodes} episodes each, seed {settings.seed}", summaries)
    if options.video is not None:
        _film(settings, who, asked.video_episodes, options)


def _film(settings: Any, who: str, episodes: int, options: argparse.Namespace) -> None:
    from needlehoop.envs.build import build
    from needlehoop.envs.controllers import controller
    from needlehoop.pictures.film import record

    if not settings.cams:
        settings = replace(settings, cams=("rgb_default", "dep_front", "seg_side"))
    settings = replace(settings, num_envs=1)
    simulation, _ = build(settings)
    record(simulation, controller(who, settings), episodes, options.video)
    if not options.json:
        print(f"video: {options.video}")


def _view(options: argparse.Namespace) -> None:
    settings, values = environment(options, "view")
    who = strict.value(values, "controller", str)
    from needlehoop.pictures.window import view

    view(settings, who)


def _grasps(values: dict[str, Any], options: argparse.Namespace) -> tuple[str, ...]:
    """Those that ``grasps`` names; by default all, or the one of ``episode.grasp=``."""
    from needlehoop.tasks.episode import GRASPS

    typed = [word for word in options.overrides if word.startswith("episode.grasp=")]
    if values["grasps"] is None:
        return (values["episode"]["grasp"],) if typed else GRASPS
    if typed:
        raise ValueError(f"grasps: {typed[0]} names one already; give only one of them")
    grasps = strict.value(values, "grasps", tuple[str, ...])
    strict.check_names("grasps", grasps, GRASPS)
    if not grasps:
        raise ValueError(f"grasps: name one or more of {', '.join(GRASPS)}")
    return grasps


def _signals(options: argparse.Namespace) -> None:
    settings, _ = environment(options)
    from needlehoop.scene.signals import describe

    print(describe(settings.definition.signals))


def _tasks(options: argparse.Namespace) -> None:
    from needlehoop.config.own_folder import part, task_folder
    from needlehoop.config.task_options import variants
    from needlehoop.runs.shipped import CONF
    from needlehoop.tasks.registry import add_folder, find, names

    for word in options.overrides:
        key = word.partition("=")[0]
        if key not in ("conf_dir", "task_dir"):
            raise ValueError(f"{key}: unknown key; choose from conf_dir, task_dir")
    _, folders = part(options.overrides)
    if own := task_folder(options.overrides):
        add_folder(own)
    for name in names():
        task = find(name)
        print(f"{name}: {task.summary}")
        for fact in task.facts:
            row = task.signals[fact.name]
            told = " (kept from reward writers)" if row.source == "verdict" else ""
            print(f"  fact        {fact.name}: {row.meaning}{told}")
        print(f"  phases      {', then '.join(f'{p.name} until {p.ends}' for p in task.phases)}")
        print(f"  controllers {', '.join(task.controllers)}; {task.teacher} is imitated")
        print(f"  variants    {', '.join(variants(name, [CONF, *folders]))}")


def _print_table(title: str, columns: dict[str, dict[str, float | int]]) -> None:
    print(title)
    names = list(next(iter(columns.values())))
    print(" " * 12 + "".join(f"{column:>12}" for column in columns))
    for name in names:
        form = "12d" if isinstance(next(iter(columns.values()))[name], int) else "12.3f"
        cells = "".join(f"{column[name]:{form}}" for column in columns.values())
        print(f"{name:12}{cells}")
