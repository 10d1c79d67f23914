"""Commands that let a trained agent act: ``needlehoop evaluate``, ``watch``."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed


def add_commands(commands: Any) -> None:
    """Add the commands to the subparsers of ``needlehoop``."""
    evaluated = commands.add_parser(
        "evaluate",
        help="Evaluate a trained run: success, return, cheat rate, a video.",
        description="Evaluate a trained run and write evaluation.json into its folder. What an"
        " earlier evaluation wrote is kept under a number.",
        epilog="Keys: episodes=100 seed=… video=false video_episodes=3 device=auto trust=false;"
        " reward=human (or any other) scores by it, and writes nothing but the video.",
    )
    evaluated.add_argument("run_folder", type=Path, metavar="RUN", help="the run's folder")
    evaluated.set_defaults(run=_evaluate)
    watched = commands.add_parser(
        "watch",
        help="Watch a trained agent: a few fresh episodes, in a window or as a film.",
        description="Run a few episodes that the agent has never met, say what came of them, and"
        " show some in a window, or write a film where there is no display. Nothing is written"
        " into the run's folder; a film that is there is kept under a number.",
        epilog="Keys: episodes=10 seed=… video_episodes=3 window=… out=watch.mp4 device=auto"
        " trust=false.",
    )
    watched.add_argument(
        "run_folder", nargs="?", metavar="RUN", help="the run's folder; the shipped agent's if none"
    )
    watched.set_defaults(run=_watch)
    for command in (evaluated, watched):
        command.add_argument("overrides", nargs="*", metavar="key=value")
        command.add_argument("--json", action="store_true", help="print one line of JSON")


def _evaluate(options: argparse.Namespace) -> None:
    from needlehoop import rewards
    from needlehoop.config import composing
    from needlehoop.envs.settings import recall_task
    from needlehoop.learning.job import checked_job, pick_device
    from needlehoop.runs.files import VIDEO
    from needlehoop.runs.run import Run

    run = Run.open(options.run_folder)
    recorded = run.config()
    # Programs are found by the cameras.
    cams = strict.value(recorded, "cams", tuple[str, ...])
    values = composing.compose([*options.overrides, f"+cams={list(cams)}"], "evaluate")
    trust, reward = strict.value(values, "trust", bool), values.get("reward")
    recall_task(recorded, trust)
    job = checked_job(recorded)
    paid = rewards.recall(job.env.reward, trust) if reward is None else rewards.allow(reward)
    job = replace(job, env=replace(job.env, reward=paid))
    episodes, filmed = (strict.value(values, key, Count) for key in ("episodes", "video_episodes"))
    given = strict.value(values, "seed", Seed | None)
    seed = job.evaluation.final_seed if given is None else given
    video = strict.value(values, "video", bool)
    device = pick_device(strict.value(values, "device", str))
    from needlehoop.learning.evaluate import assess, film, load_agent, report

    agent = load_agent(run, job, device)
    found = assess(run, agent, job, episodes, seed, kept=reward is None)
    print(json.dumps(found) if options.json else report(job.env.definition, found))
    if video:
        out = run.vacate(VIDEO)
        film(job.env, agent, filmed, seed, out)
        if not options.json:
            print(f"video        {out}")


def _watch(options: argparse.Namespace) -> None:
    from needlehoop.config import composing
    from needlehoop.learning.job import pick_device, recorded_job
    from needlehoop.pictures.window import check_display, has_display
    from needlehoop.runs.files import set_aside
    from needlehoop.runs.run import Run
    from needlehoop.runs.shipped import AGENT

    named, words = options.run_folder, options.overrides
    if named is not None and "=" in named and not Path(named).exists():
        named, words = None, [named, *words]
    run = Run.open(AGENT if named is None else Path(named))
    values = composing.compose(words, "watch")
    job = recorded_job(run.config(), strict.value(values, "trust", bool))
    episodes, shown = (strict.value(values, key, Count) for key in ("episodes", "video_episodes"))
    given = strict.value(values, "seed", Seed | None)
    seed = job.evaluation.final_seed + 1 if given is None else given
    window = values["window"]
    window = has_display() if window is None else strict.value(values, "window", bool)
    if window:
        check_display("window=false writes a film")
    out = Path(strict.value(values, "out", str))
    device = pick_device(strict.value(values, "device", str))
    if out.suffix.lower() != ".mp4":
        raise ValueError(f"out: {str(out)!r} must end in .mp4")
    from needlehoop.learning.evaluate import film, load_agent, report, show, try_out

    agent = load_agent(run, job, device)
    found = {"run": str(run.folder), **try_out(agent, job, episodes, seed)}
    print(
        json.dumps(found)
        if options.json
        else f"run          {run.folder}\n{report(job.env.definition, found)}"
    )
    if window:
        show(job.env, agent, shown, seed)
        return
    set_aside(out)
    film(job.env, agent, shown, seed, out)
    if not options.json:
        print(f"film         {out}")
