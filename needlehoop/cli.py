"""The ``needlehoop`` command.

Every command takes Hydra overrides (``key=value``) and a few flags. Errors in what was
asked for are one line on standard error and exit status 2; a command that judges something
says no with exit status 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from needlehoop.command import add_command
from needlehoop.probe.commands import add_commands as add_probe_commands
from needlehoop.study.commands import add_commands as add_study_commands
from needlehoop.vlm.commands import add_commands as add_vlm_commands


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    parser = _parser()
    options, rest = parser.parse_known_args(arguments)
    flags = [word for word in rest if word.startswith("-")]
    if flags:
        parser.error(f"unknown option {flags[0]}; see `needlehoop {options.command} --help`")
    options.overrides += rest
    try:
        status = options.run(options)
    except (ValueError, RuntimeError, OSError) as error:
        print(f"needlehoop {options.command}: {error}", file=sys.stderr)
        return 2
    return status or 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="needlehoop", description="Needle through a hoop: simulate it, look at it, measure it."
    )
    commands = parser.add_subparsers(dest="command", required=True)

    add = partial(add_command, commands)
    add(
        "snapshot",
        _snapshot,
        "Write a contact sheet of all views and renderings, start and goal.",
        "size=256 out=snapshot.png raw=false overwrite=false",
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
        "episodes=200 controller=expert|cheat|random grasps=[weld,friction] video_episodes=3"
        " overwrite=false",
    )
    run.add_argument("--json", action="store_true", help="print one line of JSON")
    run.add_argument("--video", type=Path, metavar="OUT.mp4", help="also write a video")
    evaluated = commands.add_parser(
        "evaluate",
        help="Evaluate a trained run: success, return, cheat rate, a video.",
        description="Evaluate a trained run and write evaluation.json into its folder. What an"
        " earlier evaluation wrote is kept under a number.",
        epilog="Keys: episodes=100 seed=… video=false video_episodes=3 device=auto.",
    )
    evaluated.add_argument("run_folder", type=Path, metavar="RUN", help="the run's folder")
    evaluated.add_argument("overrides", nargs="*", metavar="key=value")
    evaluated.add_argument("--json", action="store_true", help="print one line of JSON")
    evaluated.set_defaults(run=_evaluate)
    add(
        "view",
        _view,
        "Watch in MuJoCo's interactive viewer.",
        "controller=expert|cheat|random",
    )
    bench = add(
        "bench",
        _bench,
        "Measure the environment's speed (the default), training's or a reward program's, or the"
        " physics' stability.",
        "speed|train|stability|program (a bare word, or what=…) rounds=5 steps=40 episodes=1000",
    )
    bench.add_argument("--json", action="store_true", help="print one line of JSON")
    add_vlm_commands(commands)
    signals = commands.add_parser("signals", help="Print the table of signals.")
    signals.set_defaults(run=_signals, overrides=[])
    add_study_commands(commands)
    add_probe_commands(commands)
    return parser


def _snapshot(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.pictures import contact_sheet

    values = config.compose(options.overrides, "snapshot")
    out = _png(values)
    if not isinstance(values["raw"], bool):
        raise ValueError(f"raw: {values['raw']!r} is not true or false")
    sheet = contact_sheet(config.structure(values), _whole(values, "size"), values["raw"])
    _save(sheet, out)


def _picture(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.pictures import portrait

    values = config.compose(options.overrides, "picture")
    out = _png(values)
    _save(portrait(config.structure(values), _whole(values, "size")), out)


def _png(values: dict[str, Any]) -> Path:
    out = Path(values["out"])
    if out.suffix.lower() != ".png":
        raise ValueError(f"out: {str(out)!r} must end in .png")
    _spare(out, values, "out")
    return out


def _spare(out: Path, values: dict[str, Any], key: str) -> None:
    """Refuse to write over a file unless told to."""
    if not isinstance(values["overwrite"], bool):
        raise ValueError(f"overwrite: {values['overwrite']!r} is not true or false")
    if out.exists() and not values["overwrite"]:
        raise ValueError(f"{key}: {str(out)!r} exists; choose another or say overwrite=true")


def _save(image: Any, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    image.save(out)
    print(f"{out}: {image.width} x {image.height} px")


def _expert(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.trials import run_trials

    values = config.compose(options.overrides, "expert")
    settings, who = config.structure(values), values["controller"]
    episodes = _whole(values, "episodes")
    if options.video is not None:
        if options.video.suffix.lower() != ".mp4":
            raise ValueError(f"--video: {str(options.video)!r} must end in .mp4")
        _spare(options.video, values, "--video")
    summaries = {}
    for grasp in values["grasps"]:
        tried = replace(settings, episode=replace(settings.episode, grasp=grasp))
        summaries[grasp] = run_trials(tried, who, episodes).summary()
    if options.json:
        print(json.dumps({"controller": who, "seed": settings.seed, **summaries}))
    else:
        _print_table(f"{who}, {episodes} episodes per grasp, seed {settings.seed}", summaries)
    if options.video is not None:
        _film(settings, who, _whole(values, "video_episodes"), options)


def _film(settings: Any, who: str, episodes: int, options: argparse.Namespace) -> None:
    from needlehoop.controllers import controller
    from needlehoop.pictures import record
    from needlehoop.settings import build

    if episodes < 1:
        raise ValueError(f"video_episodes: {episodes} must be at least 1")
    if not settings.cams:
        settings = replace(settings, cams=("rgb_default", "dep_front", "seg_side"))
    settings = replace(settings, num_envs=1)
    simulation, imager = build(settings)
    record(settings, simulation, imager, controller(who, settings), episodes, options.video)
    if not options.json:
        print(f"video: {options.video}")


def _evaluate(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.evaluate import assess, film, load_agent, report
    from needlehoop.files import VIDEO
    from needlehoop.job import pick_device
    from needlehoop.run import Run

    run = Run.open(options.run_folder)
    values, job = config.compose(options.overrides, "evaluate"), config.job(run.config())
    episodes, video_episodes = _whole(values, "episodes"), _whole(values, "video_episodes")
    seed = job.evaluation.seed + 1 if values["seed"] is None else _whole(values, "seed")
    if not isinstance(values["video"], bool):
        raise ValueError(f"video: {values['video']!r} is not true or false")
    agent = load_agent(run, job, pick_device(values["device"]))
    found = assess(run, agent, job, episodes, seed)
    print(json.dumps(found) if options.json else report(found))
    if values["video"]:
        out = run.vacate(VIDEO)
        film(job.env, agent, video_episodes, seed, out)
        if not options.json:
            print(f"video        {out}")


def _view(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.viewer import view

    values = config.compose(options.overrides, "view")
    view(config.structure(values), values["controller"])


def _bench(options: argparse.Namespace) -> None:
    from needlehoop import config

    given = [f"what={word}" if "=" not in word else word for word in options.overrides]
    if "what=train" in given:
        found: dict[str, Any] = _bench_train([word for word in given if word != "what=train"])
        print(json.dumps(found)) if options.json else _print_nested(found)
        return
    values = config.compose(given, "bench")
    settings = config.structure(values)
    if values["what"] == "speed":
        from needlehoop.bench import measure

        found = measure(settings, _whole(values, "rounds"), _whole(values, "steps"))
    elif values["what"] == "stability":
        from needlehoop.stability import shake

        found = shake(settings, _whole(values, "episodes")).as_dict()
    elif values["what"] == "program":
        from needlehoop.bench_program import measure_program

        found = measure_program(settings.num_envs, _whole(values, "rounds"))
    else:
        raise ValueError(
            f"what: {values['what']!r} is unknown; choose from speed, train, stability, program"
        )
    if options.json:
        print(json.dumps(found))
    else:
        _print_nested(found)


def _bench_train(overrides: list[str]) -> dict[str, Any]:
    from needlehoop import config
    from needlehoop.bench_train import measure_training

    values = config.compose(overrides, "bench_train")
    return measure_training(config.job(values), _whole(values, "rounds"))


def _signals(options: argparse.Namespace) -> None:
    from needlehoop.signals import TABLE, describe

    print(describe(TABLE))


def _whole(values: dict[str, Any], key: str) -> int:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{key}: {value!r} is not a whole number")
    return value


def _print_table(title: str, columns: dict[str, dict[str, float | int]]) -> None:
    print(title)
    names = list(next(iter(columns.values())))
    print(" " * 12 + "".join(f"{column:>12}" for column in columns))
    for name in names:
        cells = "".join(f"{column[name]:12.3f}" for column in columns.values())
        print(f"{name:12}{cells}")


def _print_nested(values: dict[str, Any], indent: str = "") -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            print(f"{indent}{name}:")
            _print_nested(value, indent + "  ")
        else:
            print(f"{indent}{name}: {value}")


if __name__ == "__main__":
    sys.exit(main())
