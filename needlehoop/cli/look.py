"""Commands that show the scene or a controller: ``needlehoop snapshot``, ``expert``, …"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from needlehoop.cli.command import add_command
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


def _snapshot(options: argparse.Namespace) -> None:
    from needlehoop.config import composing

    values = composing.compose(options.overrides, "snapshot")
    from needlehoop.envs.settings import settings_from

    settings, tiled = settings_from(values), strict.value(values, "tiles", bool)
    if tiled:
        _tiles(settings, values)
        return
    out = _png(values)
    size, raw = strict.value(values, "size", Pixels), strict.value(values, "raw", bool)
    if strict.value(values, "disturbed", bool):
        from needlehoop.pictures.disturbed import disturbed_sheet

        levels = strict.value(values, "levels", Levels)
        _save(disturbed_sheet(settings, levels, size), out)
        return
    from needlehoop.pictures.stills import contact_sheet

    _save(contact_sheet(settings, size, raw), out)


def _tiles(settings: Any, values: dict[str, Any]) -> None:
    """A folder with a file for each camera."""
    out = Path(strict.value(values, "out", str))
    if out.suffix:
        raise ValueError(f"out: {str(out)!r}; tiles=true writes a folder")
    _spare(out, values, "out")
    from needlehoop.pictures.stills import tiles

    for name, image in tiles(settings).items():
        _save(image, out / f"{name}.png")


def _picture(options: argparse.Namespace) -> None:
    from needlehoop.config import composing

    values = composing.compose(options.overrides, "picture")
    from needlehoop.envs.settings import settings_from

    settings, out = settings_from(values), _png(values)
    size = strict.value(values, "size", Pixels)
    from needlehoop.pictures.stills import portrait

    _save(portrait(settings, size), out)


def _png(values: dict[str, Any]) -> Path:
    out = Path(strict.value(values, "out", str))
    if out.suffix.lower() != ".png":
        raise ValueError(f"out: {str(out)!r} must end in .png")
    _spare(out, values, "out")
    return out


def _spare(out: Path, values: dict[str, Any], key: str) -> None:
    """Refuse to write over a file unless told to."""
    overwrite = strict.value(values, "overwrite", bool)
    if out.exists() and not overwrite:
        raise ValueError(f"{key}: {str(out)!r} exists; choose another or say overwrite=true")


def _save(image: Any, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    image.save(out)
    print(f"{out}: {image.width} x {image.height} px")


def _expert(options: argparse.Namespace) -> None:
    from needlehoop.config import composing

    values = composing.compose(options.overrides, "expert")
    from needlehoop.envs.settings import settings_from

    settings, who = settings_from(values), strict.value(values, "controller", str)
    episodes = strict.value(values, "episodes", Count)
    filmed, grasps = strict.value(values, "video_episodes", Count), _grasps(values, options)
    if options.video is not None:
        if options.video.suffix.lower() != ".mp4":
            raise ValueError(f"--video: {str(options.video)!r} must end in .mp4")
        _spare(options.video, values, "--video")
    from needlehoop.envs.controllers import run_trials
    from needlehoop.tasks.episode import ArmEpisode

    summaries = {}
    for grasp in grasps if isinstance(settings.episode, ArmEpisode) else ("episodes",):
        tried = settings
        if isinstance(settings.episode, ArmEpisode):
            tried = replace(settings, episode=replace(settings.episode, grasp=grasp))
        summaries[grasp] = run_trials(tried, who, episodes).summary()
    if options.json:
        print(json.dumps({"controller": who, "seed": settings.seed, **summaries}))
    else:
        _print_table(f"{who}, {episodes} episodes each, seed {settings.seed}", summaries)
    if options.video is not None:
        _film(settings, who, filmed, options)


def _film(settings: Any, who: str, episodes: int, options: argparse.Namespace) -> None:
    from needlehoop.envs.build import build
    from needlehoop.envs.controllers import controller
    from needlehoop.pictures.film import record

    if not settings.cams:
        settings = replace(settings, cams=("rgb_default", "dep_front", "seg_side"))
    settings = replace(settings, num_envs=1)
    simulation, imager = build(settings)
    record(settings, simulation, imager, controller(who, settings), episodes, options.video)
    if not options.json:
        print(f"video: {options.video}")


def _view(options: argparse.Namespace) -> None:
    from needlehoop.config import composing

    values = composing.compose(options.overrides, "view")
    from needlehoop.envs.settings import settings_from

    settings, who = settings_from(values), strict.value(values, "controller", str)
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
    for grasp in grasps:
        if grasp not in GRASPS:
            raise ValueError(f"grasps: {grasp!r} is unknown; choose from {', '.join(GRASPS)}")
    if not grasps:
        raise ValueError(f"grasps: name one or more of {', '.join(GRASPS)}")
    return grasps


def _signals(options: argparse.Namespace) -> None:
    from needlehoop.config import composing

    values = composing.compose(options.overrides)
    from needlehoop.envs.settings import settings_from
    from needlehoop.scene.signals import describe

    print(describe(settings_from(values).definition.signals))


def _print_table(title: str, columns: dict[str, dict[str, float | int]]) -> None:
    print(title)
    names = list(next(iter(columns.values())))
    print(" " * 12 + "".join(f"{column:>12}" for column in columns))
    for name in names:
        form = "12d" if isinstance(next(iter(columns.values()))[name], int) else "12.3f"
        cells = "".join(f"{column[name]:{form}}" for column in columns.values())
        print(f"{name:12}{cells}")
