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
    keys, words = beside_a_run(
        options, "evaluate", episodes=Count | None, seed=Seed | None, **kinds
    )
    name = vars(keys)["as"]
    if name is not None:
        check_name("as", name)
    job, agent, result, lines = _flown(run, keys, words, "evaluate")
    final = job.evaluation
    usual = {"episodes": final.final_episodes, "seed": final.final_seed, "policy": "last"}
    differs = [changing.setting(word) for word in (words if "changed" in result else [])]
    differs += [(key, str(result[key])) for key, value in usual.items() if result[key] != value]
    place, is_new = _place(run, result, differs, name)
    if is_new:
        run.write(place, json.dumps(result, indent=2) + "\n")
    label = "written     " if is_new else "the same as "
    lines = f"{lines}\n{label} {run.folder / place}"
    print(json.dumps(result) if options.json else lines, flush=True)
    if keys.video:
        from needlehoop.learning.evaluate import film

        out = run.vacate(str(Path(place).with_name(VIDEO)))
        film(job.env, agent, keys.video_episodes, result["seed"], out)
        if not options.json:
            print(f"video        {out}")


def _place(
    run: Run, result: Mapping[str, Any], differs: list[tuple[str, str]], name: str | None
) -> tuple[str, bool]:
    """The file of an evaluation, and whether it is to be written.

    The run's own is written if there is none yet, or if training went on since. Any other
    has a folder of its own.
    """
    if name is None and not differs:
        try:
            former = read_json(run.folder / EVALUATION)
        except UnreadableError:
            return EVALUATION, True
        if former.get("steps_trained") != result["steps_trained"]:
            return EVALUATION, True
        if all(former[key] == result[key] for key in {*former} & {*result}):
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
    keys, words = beside_a_run(options, "watch", seed=Seed | None, **kinds)
    out = new_file(keys.out, ".mp4", overwrite=True)
    job, agent, result, lines = _flown(run, keys, words, "watch", later=1)
    del result["steps_trained"]
    result = {"run": str(run.folder), **result}
    print(json.dumps(result) if options.json else lines, flush=True)
    from needlehoop.learning.evaluate import film

    set_aside(out)
    film(job.env, agent, keys.video_episodes, result["seed"], out)
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

    folder = Path(options.who)
    kinds = {"axes": strict.Names, "levels": Levels, "severities": tuple[Count, ...]}
    kinds |= {"threads": Number, "out": str | None}
    kinds |= dict.fromkeys(("together", "episodes", "num_envs"), Count)
    keys, conditions = beside_a_run(options, "stress", seed=Seed | None, **kinds)
    if keys.out is None and (conditions or not folder.is_dir()):
        raise ValueError(
            "out: stress.csv in a run's folder is of the run's own conditions; name another file,"
            " such as out=stress.csv"
        )
    out = new_file(folder / STRESS if keys.out is None else keys.out, ".csv", overwrite=True)
    device = pick_device(keys.device)
    from needlehoop.learning import stress

    if folder.is_dir():
        from needlehoop.learning.subject import of_run

        settings, make = of_run(folder, conditions, keys.seed, device, keys.trust, "stress")
    else:
        from needlehoop.envs.controllers import by_name, controllers
        from needlehoop.envs.settings import compose_settings

        # As in a run's final evaluation by default.
        seed = 1_000_001 if keys.seed is None else keys.seed
        settings = replace(compose_settings([*conditions, f"seed={seed}"]), cams=())
        strict.check_names("a run's folder or controller", [options.who], controllers(settings))
        make = by_name(options.who)
    chosen = stress.chosen_axes(keys.axes, blind=not settings.cams)
    tried = stress.conditions(keys.levels, chosen, keys.severities, keys.together)
    settings = replace(settings, engine=replace(settings.engine, threads=keys.threads))
    rows = stress.stress(settings, make, tried, keys.episodes, keys.num_envs)
    set_aside(out)
    write_whole(out, csv_text(rows[0], (row.values() for row in rows)))
    print(f"{stress.summary(rows)}\ntable        {out}")


def _flown(
    run: Run, keys: Any, conditions: list[str], command: str, later: int = 0
) -> tuple[Job, Agent, dict[str, Any], str]:
    """A run's job and agent, and an evaluation of these: its numbers, and lines that show them.

    A seed that was not typed is that of the run's own evaluation plus ``later``.
    """
    # A wrong key is refused before the agent is imported, which takes seconds.
    changing.check(conditions, run.config(), command)
    import torch

    from needlehoop.learning.evaluate import (
        assess,
        load_agent,
        policy_in_words,
        report,
        which_policy,
    )
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import flown_job

    device = pick_device(keys.device)
    job, changed = flown_job(run.config(), conditions, keys.trust, command)
    policy, steps = which_policy(run, keys.policy)
    usual = job.evaluation
    episodes = usual.final_episodes if keys.episodes is None else keys.episodes
    seed = usual.final_seed + later if keys.seed is None else keys.seed
    # As in training: their number decides how sums are rounded.
    torch.set_num_threads(1)
    agent = load_agent(run, job, device, policy)
    result = {"steps_trained": steps, "policy": policy, **assess(agent, job, episodes, seed)}
    lines = [f"run          {run.folder}", f"policy       {policy_in_words(policy, steps)}"]
    if changed:
        result["changed"] = changed
        lines.append(f"changed      {' '.join(conditions)}")
    return job, agent, result, "\n".join([*lines, report(job.env.definition, result)])


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
    settings, keys = environment(options, "expert", episodes=Count, video_episodes=Count, **kinds)
    pilot, rules = keys.controller, settings.episode
    if options.video is not None:
        new_file(options.video, ".mp4", keys.overwrite, "--video")
    from needlehoop.envs.controllers import run_trials
    from needlehoop.tasks.layout import GRASPS, ArmEpisode

    cases = {"episodes": settings}
    if isinstance(rules, ArmEpisode):
        grasps = [rules.grasp] if typed(options.overrides, "episode.grasp") else GRASPS
        cases = {grasp: replace(settings, episode=replace(rules, grasp=grasp)) for grasp in grasps}
    columns = {key: run_trials(case, pilot, keys.episodes).summary() for key, case in cases.items()}
    if options.json:
        print(json.dumps({"controller": pilot, "seed": settings.seed, **columns}))
    else:
        print(f"{pilot}, {keys.episodes} episodes each, seed {settings.seed}")
        print(" " * 12 + "".join(f"{column:>12}" for column in columns))
        for name, first in next(iter(columns.values())).items():
            form = "12d" if isinstance(first, int) else "12.3f"
            print(f"{name:12}{''.join(f'{column[name]:{form}}' for column in columns.values())}")
    if options.video is None:
        return
    from needlehoop.envs.build import build
    from needlehoop.envs.controllers import controller
    from needlehoop.pictures.film import record

    cams = settings.cams or ("rgb_default", "dep_front", "seg_side")
    simulation = build(replace(settings, cams=cams, num_envs=1))
    record(simulation, controller(pilot, settings), keys.video_episodes, options.video)
    if not options.json:
        print(f"video: {options.video}")
