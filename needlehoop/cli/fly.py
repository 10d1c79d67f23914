"""Commands in which a trained agent or a scripted controller acts for its own sake."""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import JSON, KEYS, argument, command, new_file
from needlehoop.cli.look import Levels
from needlehoop.config import strict
from needlehoop.config.strict import Count, Number, Seed

if TYPE_CHECKING:
    from needlehoop.demonstrations.episodes import Demonstration
    from needlehoop.learning.agent import Agent
    from needlehoop.learning.job import Job
    from needlehoop.runs.run import Run


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
    from needlehoop.config.changing import setting
    from needlehoop.runs.files import VIDEO, check_name
    from needlehoop.runs.run import Run

    run, kinds = Run.open(options.run_folder), {"as": str | None}
    own, words = _asked(options, "evaluate", episodes=Count | None, video=bool, **_SHOWN, **kinds)
    name = vars(own)["as"]
    if name is not None:
        check_name("as", name)
    job, agent, found, lines = _flown(run, own, words, "evaluate")
    own_ends = job.evaluation.final_episodes, job.evaluation.final_seed, "last"
    usual = zip(("episodes", "seed", "policy"), own_ends, strict=True)
    differs = [setting(word) for word in (words if "changed" in found else [])]
    differs += [(key, str(found[key])) for key, value in usual if found[key] != value]
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


_SHOWN = {"policy": str | None, "video_episodes": Count}
"""Types of the keys of commands that show an agent."""


def _asked(options: argparse.Namespace, command: str, **kinds: Any) -> tuple[Any, list[str]]:
    """What was typed beside a run: the command's own settings, and words that change the run's.

    ``kinds`` are types of the command's own keys, beside those of all such commands.
    """
    from needlehoop.config import composing
    from needlehoop.config.changing import parted

    mine, conditions = parted(options.overrides, command)
    values = composing.compose(mine, command)
    return strict.read(values, trust=bool, seed=Seed | None, device=str, **kinds), conditions


def _flown(
    run: Run, own: Any, conditions: list[str], command: str, later: int = 0
) -> tuple[Job, Agent, dict[str, Any], str]:
    """A run's agent and its evaluation as numbers and in lines, as it was asked for.

    Args:
        later: how many seeds after that of the run's own evaluation, if none was typed.
    """
    from needlehoop.config.changing import check

    check(conditions, run.config(), command)
    # What this refuses does not wait for the agent.
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


def _place(
    run: Run, found: Mapping[str, Any], differs: list[tuple[str, str]], name: str | None
) -> tuple[str, bool]:
    """The file of an evaluation, and whether it is to be written.

    The run's own is written where there is none, or where training has gone on since. Any other
    has a folder of its own.
    """
    from needlehoop.runs.files import EVALUATION, FURTHER, name_of
    from needlehoop.runs.reading import UnreadableError, read_json

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
    argument(
        "run_folder", nargs="?", metavar="RUN", help="the run's folder; the shipped agent's if none"
    ),
    KEYS,
    JSON,
    config="watch",
)
def watch(options: argparse.Namespace) -> None:
    """Watch a trained agent: a few fresh episodes, in a window or as a film.

    Run a few episodes that the agent has never met, say what came of them, and show some in a
    window, or write a film where there is no display. Nothing is written into the run's folder; a
    film that is there is kept under a number. Conditions of the run that are to be changed:
    task=wide views.front.azimuth=5 …
    """
    from needlehoop.config.options import typed
    from needlehoop.pictures.window import check_display, has_display
    from needlehoop.runs.files import set_aside
    from needlehoop.runs.run import Run
    from needlehoop.runs.shipped import agent_of

    named = options.run_folder
    if named is not None and "=" in named and not Path(named).exists():
        options.overrides.insert(0, named)
        named = None
    task = ["", *typed(options.overrides, "task")][-1]
    run = Run.open(agent_of(task) if named is None else Path(named))
    kinds = {"episodes": Count, "window": bool | None, "out": str}
    own, words = _asked(options, "watch", **_SHOWN, **kinds)
    window = has_display() if own.window is None else own.window
    if window:
        check_display("window=false writes a film")
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
    argument(
        "who", metavar="WHO", help="a run's folder, a policy.safetensors, or expert, smooth, …"
    ),
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
    from needlehoop.runs.files import STRESS, csv_text, set_aside, write_whole

    who = Path(options.who)
    kinds = {"axes": strict.Names, "levels": Levels, "threads": Number, "out": str | None}
    kinds |= {"severities": tuple[Count, ...]}
    counts = dict.fromkeys(("together", "episodes", "num_envs"), Count)
    asked, conditions = _asked(options, "stress", **kinds, **counts)
    if asked.out is None and (conditions or not who.is_dir()):
        raise ValueError(
            "out: stress.csv in a run's folder is of the run's own conditions; name another file,"
            " such as out=stress.csv"
        )
    out = new_file(who / STRESS if asked.out is None else asked.out, ".csv", overwrite=True)
    device = pick_device(asked.device)
    from needlehoop.learning import stress
    from needlehoop.learning.subject import subject

    tested = subject(options.who, conditions, asked.seed, device, asked.trust)
    chosen = stress.chosen_axes(asked.axes, blind=tested.blind)
    tried = stress.conditions(asked.levels, chosen, asked.severities, asked.together)
    engine = replace(tested.settings.engine, threads=asked.threads)
    settings = replace(tested.settings, engine=engine)
    rows = stress.stress(settings, tested.make, tried, asked.episodes, asked.num_envs)
    set_aside(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, csv_text(rows[0], (row.values() for row in rows)))
    print(f"{stress.summary(rows)}\ntable        {out}")


@command(KEYS, config="demonstrations")
def demonstrations(options: argparse.Namespace) -> None:
    """Write episodes of an expert or a trained run as a dataset: Minari or LeRobot."""
    from tqdm import tqdm

    from needlehoop.config import composing
    from needlehoop.config.changing import parted
    from needlehoop.config.options import typed
    from needlehoop.demonstrations.episodes import demonstrate, scripted
    from needlehoop.runs.files import new_folder
    from needlehoop.runs.machine import provenance

    words = options.overrides
    is_run = any(Path(one).is_dir() for one in typed(words, "demonstrator")[-1:])
    others = parted(words, "demonstrations")[1] if is_run else []
    conditions = [word for word in others if not typed([word], "seed")]
    values = composing.compose((w for w in words if w not in conditions), "demonstrations")
    kinds = {"demonstrator": str | None, "out": str | None, "overwrite": bool, "trust": bool}
    asked = strict.read(values, episodes=Count, format=str, device=str, seed=Seed, **kinds)
    if not asked.out:
        raise ValueError("out: give a folder for the dataset, such as out=demos/smooth-v0")
    out = Path(asked.out)
    write = _writer(asked.format, out.name)
    from needlehoop.envs.settings import settings_from
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import of_run

    if is_run:
        who, device = asked.demonstrator, pick_device(asked.device)
        seed = asked.seed if typed(words, "seed") else None
        chosen = Path(who), conditions, seed, device, asked.trust, "demonstrations"
        # Two after those of its evaluations and of watch.
        settings, make = of_run(*chosen, later=2)
    else:
        settings = settings_from(values)
        who = asked.demonstrator or settings.definition.teacher
        make = scripted(who, settings.definition)
    counts = Counter()

    def shown() -> Iterator[Demonstration]:
        found = demonstrate(settings, make, asked.episodes)
        for one in tqdm(found, total=asked.episodes, unit="episode", dynamic_ncols=True):
            counts.update(steps=len(one), successful=int(one.success))
            yield one

    with new_folder(out, asked.overwrite) as folder:
        write(folder, shown(), settings, who, provenance())
    print(
        f"{out}: {asked.episodes} episodes (seed {settings.seed}), {counts['steps']} steps,"
        f" {counts['successful']} successful"
    )


def _writer(name: str, dataset: str) -> Callable[..., None]:
    """What writes datasets of a format; ``dataset`` is the name of the folder."""
    strict.check_names("format", [name], ("minari", "lerobot"))
    try:
        found = import_module(f"needlehoop.demonstrations.{name}_layout")
    except ModuleNotFoundError as error:
        raise ValueError(
            f"format={name} needs {error.name}: pip install 'needlehoop[{name}]'"
        ) from error
    if name == "minari" and not re.fullmatch(r"[\w.-]+-v\d+", dataset):
        raise ValueError(
            f"out: {dataset!r} is no name for Minari, which wants a version: such as smooth-v0"
        )
    return found.write
