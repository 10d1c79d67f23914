"""Commands in which a trained agent or a scripted controller acts, and what came of it is told."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import (
    JSON,
    KEYS,
    argument,
    beside_a_run,
    command,
    environment,
    new_file,
)
from needlehoop.cli.scenes import Levels
from needlehoop.config import changing, strict
from needlehoop.config.options import typed
from needlehoop.config.strict import Count, Number, Seed
from needlehoop.runs.files import (
    EVALUATION,
    FURTHER,
    STRESS,
    VIDEO,
    check_name,
    csv_text,
    name_of,
    set_aside,
    write_whole,
)
from needlehoop.runs.reading import UnreadableError, read_json
from needlehoop.runs.shipped import agent_of

if TYPE_CHECKING:
    from needlehoop.learning.job import Job
    from needlehoop.learning.networks import Agent
    from needlehoop.runs.run import Run

_OF_POLICY = {"policy": str | None, "video_episodes": Count}
"""Types of the keys of commands that show an agent."""


@command(
    argument("run_folder", type=Path, metavar="RUN", help="the run's folder"),
    KEYS,
    JSON,
    config="evaluate",
)
def evaluate(options: argparse.Namespace) -> None:
    """Evaluate a trained run: success, return, cheat rate, a video.

    Its own evaluation is evaluation.json, which stays as it is; one of other episodes, of the best
    policy or under changed conditions goes into a folder of its own, evaluations/<as>. Conditions
    of the run that are to be changed: task=wide views.front.azimuth=5 …
    """
    from needlehoop.runs.run import Run

    run = Run.open(options.run_folder)
    kinds = {"as": str | None, "video": bool, **_OF_POLICY}
    own, words = beside_a_run(options, "evaluate", episodes=Count | None, seed=Seed | None, **kinds)
    name = vars(own)["as"]
    if name is not None:
        check_name("as", name)
    job, agent, found, lines = _flown(run, own, words, "evaluate")
    final = job.evaluation
    usual = {"episodes": final.final_episodes, "seed": final.final_seed, "policy": "last"}
    differs = [changing.setting(word) for word in (words if "changed" in found else [])]
    differs += [(key, str(found[key])) for key, value in usual.items() if found[key] != value]
    place, is_new = _place(run, found, differs, name)
    if is_new:
        run.write(place, json.dumps(found, indent=2) + "\n")
    said = "written     " if is_new else "the same as "
    lines = f"{lines}\n{said} {run.folder / place}"
    print(json.dumps(found) if options.json else lines, flush=True)
    if own.video:
        from needlehoop.learning.evaluate import film

        out = run.vacate(str(Path(place).with_name(VIDEO)))
        film(job.env, agent, own.video_episodes, found["seed"], out)
        if not options.json:
            print(f"video        {out}")


def _place(
    run: Run, found: Mapping[str, Any], differs: list[tuple[str, str]], name: str | None
) -> tuple[str, bool]:
    """The file of an evaluation, and whether it is to be written.

    The run's own is written where there is none, or where training has gone on since. Any other
    has a folder of its own.
    """
    if name is None and not differs:
        try:
            former = read_json(run.folder / EVALUATION)
        except UnreadableError:
            return EVALUATION, True
        if former.get("steps_trained") != found["steps_trained"]:
            return EVALUATION, True
        if all(former[key] == found[key] for key in {*former} & {*found}):
            return EVALUATION, False
        name = "again"
    return f"{FURTHER}/{name or name_of(differs)}/{EVALUATION}", True


@command(
    argument("overrides", nargs="*", metavar="RUN | key=value"),
    JSON,
    config="watch",
)
def watch(options: argparse.Namespace) -> None:
    """Watch a trained agent: a film of a few fresh episodes.

    Run a few episodes that the agent has never met, say what came of them, and film some. Without
    a run's folder it is the shipped agent. Nothing is written into the run's folder; a film that is
    there is kept under a number. Conditions that are to be changed: task=wide …
    """
    from needlehoop.runs.run import Run

    folders = [word for word in options.overrides if "=" not in word]
    options.overrides = [word for word in options.overrides if "=" in word]
    task = ["", *typed(options.overrides, "task")][-1]
    run = Run.open(Path(folders[0]) if folders else agent_of(task))
    kinds = {"episodes": Count, "out": str, **_OF_POLICY}
    own, words = beside_a_run(options, "watch", seed=Seed | None, **kinds)
    out = new_file(own.out, ".mp4", overwrite=True)
    job, agent, found, lines = _flown(run, own, words, "watch", later=1)
    del found["steps_trained"]
    found = {"run": str(run.folder), **found}
    print(json.dumps(found) if options.json else lines, flush=True)
    from needlehoop.learning.evaluate import film

    set_aside(out)
    film(job.env, agent, own.video_episodes, found["seed"], out)
    if not options.json:
        print(f"film         {out}")


@command(
    argument("who", metavar="WHO", help="a run's folder, or expert, smooth, …"),
    KEYS,
    config="stress",
)
def stress(options: argparse.Namespace) -> None:
    """Test a policy under disturbances of cameras, pictures, scene and robot.

    Fly the same episodes undisturbed, and under each axis of disturbance at each severity, and
    write a table of what came of it: stress.csv in the run's folder. What an earlier test wrote is
    kept under a number. Conditions that are to be changed: task=wide …
    """
    from needlehoop.learning.job import pick_device

    who = Path(options.who)
    kinds = {"axes": strict.Names, "levels": Levels, "severities": tuple[Count, ...]}
    kinds |= {"threads": Number, "out": str | None}
    kinds |= dict.fromkeys(("together", "episodes", "num_envs"), Count)
    asked, conditions = beside_a_run(options, "stress", seed=Seed | None, **kinds)
    if asked.out is None and (conditions or not who.is_dir()):
        raise ValueError(
            "out: stress.csv in a run's folder is of the run's own conditions; name another file,"
            " such as out=stress.csv"
        )
    out = new_file(who / STRESS if asked.out is None else asked.out, ".csv", overwrite=True)
    device = pick_device(asked.device)
    from needlehoop.learning import stress
    from needlehoop.learning.subject import subject

    found, make = subject(options.who, conditions, asked.seed, device, asked.trust)
    chosen = stress.chosen_axes(asked.axes, blind=not found.cams)
    tried = stress.conditions(asked.levels, chosen, asked.severities, asked.together)
    settings = replace(found, engine=replace(found.engine, threads=asked.threads))
    rows = stress.stress(settings, make, tried, asked.episodes, asked.num_envs)
    set_aside(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, csv_text(rows[0], (row.values() for row in rows)))
    print(f"{stress.summary(rows)}\ntable        {out}")


def _flown(
    run: Run, own: Any, conditions: list[str], command: str, later: int = 0
) -> tuple[Job, Agent, dict[str, Any], str]:
    """A run's agent and its evaluation as numbers and in lines, as it was asked for.

    If no seed was typed, it is ``later`` than that of the run's own evaluation by so many.
    """
    # What this refuses does not wait for the agent.
    changing.check(conditions, run.config(), command)
    import torch

    from needlehoop.learning.evaluate import assess, load_agent, report, told_policy, which_policy
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import flown_job

    device = pick_device(own.device)
    job, changed = flown_job(run.config(), conditions, own.trust, command)
    policy, steps = which_policy(run, own.policy)
    usual = job.evaluation
    episodes = usual.final_episodes if own.episodes is None else own.episodes
    seed = usual.final_seed + later if own.seed is None else own.seed
    # As in training: their number decides how sums are rounded.
    torch.set_num_threads(1)
    agent = load_agent(run, job, device, policy)
    found = {"steps_trained": steps, "policy": policy, **assess(agent, job, episodes, seed)}
    lines = [f"run          {run.folder}", f"policy       {told_policy(policy, steps)}"]
    if changed:
        found["changed"] = changed
        lines.append(f"changed      {' '.join(conditions)}")
    return job, agent, found, "\n".join([*lines, report(job.env.definition, found)])


@command(
    KEYS,
    JSON,
    argument("--video", type=Path, metavar="OUT.mp4", help="also write a video"),
    config="expert",
)
def expert(options: argparse.Namespace) -> None:
    """Run a scripted controller and print what came of it.

    It grasps in both ways, weld and friction, unless one is typed as episode.grasp=.
    """
    kinds = {"controller": str, "overwrite": bool}
    settings, asked = environment(options, "expert", episodes=Count, video_episodes=Count, **kinds)
    who, rules = asked.controller, settings.episode
    if options.video is not None:
        new_file(options.video, ".mp4", asked.overwrite, "--video")
    from needlehoop.envs.controllers import run_trials
    from needlehoop.tasks.layout import GRASPS, ArmEpisode

    tried = {"episodes": settings}
    if isinstance(rules, ArmEpisode):
        grasps = [rules.grasp] if typed(options.overrides, "episode.grasp") else GRASPS
        tried = {one: replace(settings, episode=replace(rules, grasp=one)) for one in grasps}
    found = {one: run_trials(own, who, asked.episodes).summary() for one, own in tried.items()}
    if options.json:
        print(json.dumps({"controller": who, "seed": settings.seed, **found}))
    else:
        print(f"{who}, {asked.episodes} episodes each, seed {settings.seed}")
        print(" " * 12 + "".join(f"{column:>12}" for column in found))
        for name, first in next(iter(found.values())).items():
            form = "12d" if isinstance(first, int) else "12.3f"
            print(f"{name:12}{''.join(f'{column[name]:{form}}' for column in found.values())}")
    if options.video is None:
        return
    from needlehoop.envs.build import build
    from needlehoop.envs.controllers import controller
    from needlehoop.pictures.film import record

    cams = settings.cams or ("rgb_default", "dep_front", "seg_side")
    simulation = build(replace(settings, cams=cams, num_envs=1))
    record(simulation, controller(who, settings), asked.video_episodes, options.video)
    if not options.json:
        print(f"video: {options.video}")
