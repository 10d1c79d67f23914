"""Commands that let a trained agent act: ``needlehoop evaluate``, ``watch``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed

if TYPE_CHECKING:
    from needlehoop.learning.agent import Agent
    from needlehoop.learning.job import Job
    from needlehoop.runs.run import Run

_CONDITIONS = " Conditions of the run that are to be changed: task=wide views.front.azimuth=5 …"


def add_commands(commands: Any) -> None:
    """Add the commands to the subparsers of ``needlehoop``."""
    evaluated = commands.add_parser(
        "evaluate",
        help="Evaluate a trained run: success, return, cheat rate, a video.",
        description="Evaluate a trained run. Its own evaluation is evaluation.json, which stays as"
        " it is; one of other episodes, of the best policy or under changed conditions goes into a"
        " folder of its own, evaluations/<as>.",
        epilog="Keys: episodes=100 seed=… policy=last|best as=… video=false video_episodes=3"
        f" device=auto trust=false.{_CONDITIONS}",
    )
    evaluated.add_argument("run_folder", type=Path, metavar="RUN", help="the run's folder")
    evaluated.set_defaults(run=_evaluate)
    watched = commands.add_parser(
        "watch",
        help="Watch a trained agent: a few fresh episodes, in a window or as a film.",
        description="Run a few episodes that the agent has never met, say what came of them, and"
        " show some in a window, or write a film where there is no display. Nothing is written"
        " into the run's folder; a film that is there is kept under a number.",
        epilog="Keys: episodes=10 seed=… policy=last|best video_episodes=3 window=… out=watch.mp4"
        f" device=auto trust=false.{_CONDITIONS}",
    )
    watched.add_argument(
        "run_folder", nargs="?", metavar="RUN", help="the run's folder; the shipped agent's if none"
    )
    watched.set_defaults(run=_watch)
    for command in (evaluated, watched):
        command.add_argument("overrides", nargs="*", metavar="key=value")
        command.add_argument("--json", action="store_true", help="print one line of JSON")


class _Asked(NamedTuple):
    """A run, and how it is to be flown."""

    run: Run
    own: Any
    """Values of the command's own config, by their keys."""
    job: Job
    changed: dict[str, Any]
    """New values of conditions, by their key."""
    conditions: list[str]
    """What was typed to change them."""
    policy: str
    steps: int | None
    """Of its training."""

    def agent(self) -> Agent:
        import torch

        from needlehoop.learning.evaluate import load_agent
        from needlehoop.learning.job import pick_device

        # As in training: their number decides how sums are rounded.
        torch.set_num_threads(1)
        return load_agent(self.run, self.job, pick_device(self.own.device), self.policy)

    def tell(self, found: Mapping[str, Any]) -> str:
        """The evaluation in lines, after what was flown and what was changed."""
        from needlehoop.learning.evaluate import report, told_policy

        lines = [
            f"run          {self.run.folder}",
            f"policy       {told_policy(self.policy, self.steps)}",
        ]
        lines += [f"changed      {' '.join(self.conditions)}"] if self.changed else []
        return "\n".join((*lines, report(self.job.env.definition, found)))


def _asked(run: Run, words: list[str], command: str, **kinds: Any) -> _Asked:
    """What was typed beside a run.

    Args:
        kinds: types of the command's own keys, beside those of both.

    Raises:
        ValueError: a word that is wrong, or code that is not trusted.
    """
    from needlehoop.config import composing
    from needlehoop.config.changing import check, parted

    mine, conditions = parted(words, command)
    own = strict.read(
        composing.compose(mine, command),
        trust=bool,
        policy=str | None,
        seed=Seed | None,
        video_episodes=Count,
        device=str,
        **kinds,
    )
    check(conditions, run.config(), command)
    # What the lines before refuse does not wait for this.
    from needlehoop.learning.evaluate import which_policy
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import flown_job

    pick_device(own.device)
    job, changed = flown_job(run.config(), conditions, own.trust, command)
    return _Asked(run, own, job, changed, conditions, *which_policy(run, own.policy))


def _evaluate(options: argparse.Namespace) -> None:
    from needlehoop.config.changing import setting
    from needlehoop.runs.files import VIDEO, check_name
    from needlehoop.runs.run import Run

    run, kinds = Run.open(options.run_folder), {"as": str | None}
    asked = _asked(run, options.overrides, "evaluate", episodes=Count | None, video=bool, **kinds)
    from needlehoop.learning.evaluate import assess, film

    job, own, usual = asked.job, asked.own, asked.job.evaluation
    name = vars(own)["as"]
    if name is not None:
        check_name("as", name)
    episodes = usual.final_episodes if own.episodes is None else own.episodes
    seed = usual.final_seed if own.seed is None else own.seed
    agent = asked.agent()
    found = {"steps_trained": asked.steps, "policy": asked.policy}
    found |= assess(agent, job, episodes, seed)
    found |= {"changed": asked.changed} if asked.changed else {}
    differs = [
        *(setting(word) for word in (asked.conditions if asked.changed else [])),
        *([("episodes", f"{episodes}")] if episodes != usual.final_episodes else []),
        *([("seed", f"{seed}")] if seed != usual.final_seed else []),
        *([("policy", asked.policy)] if asked.policy != "last" else []),
    ]
    place, is_new = _place(run, found, differs, name)
    if is_new:
        run.write(place, json.dumps(found, indent=2) + "\n")
    said = "written     " if is_new else "the same as "
    lines = f"{asked.tell(found)}\n{said} {run.folder / place}"
    print(json.dumps(found) if options.json else lines, flush=True)
    if own.video:
        out = run.vacate(str(Path(place).with_name(VIDEO)))
        film(job.env, agent, own.video_episodes, seed, out)
        if not options.json:
            print(f"video        {out}")


def _place(
    run: Run, found: Mapping[str, Any], differs: list[tuple[str, str]], name: str | None
) -> tuple[str, bool]:
    """The file of an evaluation, and whether it is to be written.

    The run's own is written where there is none, or where training has gone on since. Any other
    has a folder of its own.
    """
    from needlehoop.runs.files import EVALUATION, FURTHER, name_of
    from needlehoop.runs.reading import UnreadableError, read_json

    path = run.folder / EVALUATION
    if name is None and not differs:
        try:
            former = read_json(path)
        except UnreadableError:
            return EVALUATION, True
        if former.get("steps_trained") != found["steps_trained"]:
            return EVALUATION, True
        if all(former[key] == found[key] for key in {*former} & {*found}):
            return EVALUATION, False
        name = "again"
    return f"{FURTHER}/{name or name_of(differs)}/{EVALUATION}", True


def _watch(options: argparse.Namespace) -> None:
    from needlehoop.pictures.window import check_display, has_display
    from needlehoop.runs.files import set_aside
    from needlehoop.runs.run import Run
    from needlehoop.runs.shipped import agent_of

    named, words = options.run_folder, options.overrides
    if named is not None and "=" in named and not Path(named).exists():
        named, words = None, [named, *words]
    tasks = [word.partition("=")[2] for word in words if word.startswith("task=")]
    folder = agent_of(*tasks[-1:] or [""]) if named is None else Path(named)
    own = {"episodes": Count, "window": bool | None, "out": str}
    asked = _asked(Run.open(folder), words, "watch", **own)
    job, own = asked.job, asked.own
    seed = job.evaluation.final_seed + 1 if own.seed is None else own.seed
    window = has_display() if own.window is None else own.window
    if window:
        check_display("window=false writes a film")
    out = Path(own.out)
    if out.suffix.lower() != ".mp4":
        raise ValueError(f"out: {str(out)!r} must end in .mp4")
    from needlehoop.learning.evaluate import assess, film, show

    agent = asked.agent()
    found = {"run": str(asked.run.folder), "policy": asked.policy}
    found |= {"changed": asked.changed} if asked.changed else {}
    found |= assess(agent, job, own.episodes, seed)
    print(json.dumps(found) if options.json else asked.tell(found), flush=True)
    if window:
        show(job.env, agent, own.video_episodes, seed)
        return
    set_aside(out)
    film(job.env, agent, own.video_episodes, seed, out)
    if not options.json:
        print(f"film         {out}")
