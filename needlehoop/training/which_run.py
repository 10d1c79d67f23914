"""Which run a command line means: a new one, the rest of one, or one that is done."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlehoop import rewards
from needlehoop.api.trained import initial_weights
from needlehoop.config import strict
from needlehoop.config.changing import differing, plain
from needlehoop.envs.settings import Settings, settings_from
from needlehoop.learning.job import Job, checked_job, typed_job
from needlehoop.learning.subject import flown_job
from needlehoop.rewards import written
from needlehoop.runs.files import CHECKPOINT, CONFIG
from needlehoop.runs.lock import held
from needlehoop.runs.machine import provenance
from needlehoop.runs.run import Run
from needlehoop.tasks.contract import Task
from needlehoop.training.options import check_options, inquiry
from needlehoop.vlm.card import card
from needlehoop.vlm.config import Gates
from needlehoop.vlm.inquiry import Inquiry
from needlehoop.vlm.writing import ProgramRules, program_rules

_OF_NO_CONSEQUENCE = {
    *("resume", "overwrite", "existing", "until", "results", "logger", "wandb"),
    *("checkpoint_every", "vlm", "asking", "gates", "weights", "trust", "keep", "objective"),
}
"""Settings that may change when a run is resumed: they do not affect its results."""

_OF_ONE_RUN = {"resume", "overwrite", "existing", "until"}
"""What was typed for one run, and not for another of the same settings."""


@dataclass(frozen=True)
class Session:
    """A run to train."""

    job: Job
    run: Run
    state: dict[str, Any] | None = None
    """Its checkpoint; ``None``: it begins."""
    weights: dict[str, Any] | None = None
    """Weights of the agent that it begins with; ``None``: new ones."""

    @property
    def steps(self) -> int:
        """Environment steps that are done."""
        return 0 if self.state is None else self.state["update"] * self.job.buffer


@contextmanager
def open_session(values: dict[str, Any], overrides: list[str], command: str) -> Iterator[Session]:
    """The run that a composed config asks for; its folder is made.

    No other process writes into the folder until the context ends, unless the run is finished.

    Args:
        command: the command before it: ``python train.py`` or ``needlehoop train``.

    Raises:
        ValueError: settings that do not go together, or a run that is in the way.
        RewardError: no model wrote a reward.
    """
    asked = check_options(values)
    if asked.resume is not None:
        run = Run.open(Path(asked.resume), "resume")
        beside = ("resume=", "trust=", "conf_dir=")
        others = [word for word in overrides if not word.startswith(beside)]
        if run.manifest().get("finished") is True:
            raise ValueError(
                f"resume: {run.folder} is finished, and its learning rate has come to its"
                f" end; train its agent on in a run of its own: {_with_agent(run, others, command)}"
            )
        if others:
            raise ValueError(
                "resume: a run goes on with its own settings; give no others with it, or begin"
                f" another with its agent: {_with_agent(run, others, command)}"
            )
        yield from _continued(run, asked.trust)
        return
    # Everything else is checked before a model is asked for a program.
    ask_where_missing(values, typed_job({**values, "reward": rewards.NONE}).env)
    values = {**values, "reward": rewards.pin(values["reward"])}
    job = typed_job(values)
    # One camera may be given as a word; what is kept is always a list.
    values["cams"] = list(job.env.cams)
    folder = Path(job.results) / job.place
    if asked.existing == "resume" and (folder / CONFIG).exists() and not asked.overwrite:
        run = Run.open(folder)
        _check_same(run, values)
        # Its reward is the one that was typed, source included.
        yield from _continued(run, trust=True, again=True)
        return
    weights = initial_weights(job)
    if against := objections(values, job.env):
        # A warning, no refusal: programs of others are tried as they are.
        print(f"reward: the gates on this program: {'; '.join(against)}", file=sys.stderr)
    with held(folder):
        reward = rewards.text(rewards.load(job.env.reward, job.env.definition))
        run = Run.create(folder, plain(values), reward, asked.overwrite)
        try:
            # Not sys.argv: a sweep's is that of all its runs, and a launcher's process has another.
            words = [*command.removeprefix("python ").split(), *overrides]
            run.note(task=task_note(job.env.definition), command=words, gates=against)
            yield Session(job, run, weights=weights)
        except BaseException:
            run.unmake()
            raise


def _continued(run: Run, trust: bool, again: bool = False) -> Iterator[Session]:
    """The rest of a run, for ``open_session``.

    Args:
        again: whether one that ended before its first checkpoint begins again.

    Raises:
        ValueError: something in its folder is damaged, or another process is at work there.
    """
    values = run.config()
    job, _ = flown_job(values, (), trust)
    if run.manifest().get("finished"):
        yield Session(job, run)
        return
    with held(run.folder):
        path = run.folder / CHECKPOINT
        if again and not run.manifest().get("steps") and not path.exists():
            run.go_on(None)
            run.note(**provenance(), wall_time=0.0, stopped=False)
            yield Session(job, run, weights=initial_weights(job))
            return
        checkpoint = run.checkpoint()
        if other := differing(checkpoint.config, values, _OF_NO_CONSEQUENCE):
            raise ValueError(
                f"{path} was trained with another {other} than {CONFIG} has now; put the"
                " file back, or begin a run of its own with study="
            )
        state = checkpoint.state
        run.go_on(checkpoint)
        run.note(steps=state["update"] * job.buffer, wall_time=state["wall_time"], stopped=False)
        yield Session(job, run, state)


def ask_where_missing(values: dict[str, Any], settings: Settings) -> None:
    """Have a model write the program of ``reward=vlm_img`` or ``vlm_text``, if none is recorded.

    It is kept in the study's folder, where the reward looks for it. ``vlm=replay`` is not asked:
    it has only what is recorded.

    Args:
        settings: its scene and cameras, with any reward.

    Raises:
        ValueError: no key, or a value that is not valid.
        RewardError: no reply, or no program that was accepted.
    """
    reward: Mapping[str, Any] = values["reward"]
    if values["vlm"]["kind"] == "replay" or written.is_recorded(reward):
        return
    asked, provider = inquiry(values)
    try:
        with Inquiry(settings, asked, provider) as opened:
            flavour, sample = written.FLAVOURS[reward["kind"]], reward["sample"]
            paths = opened.reward(flavour, rules_of(values), sample)
    except RuntimeError as error:
        raise rewards.RewardError(f"reward: no program was written: {error}") from error
    print(f"reward written to {paths[-1]}")


def objections(values: Mapping[str, Any], settings: Settings) -> list[str]:
    """What the gates refuse or flag in a training's reward; nothing where it is no program."""
    reward = rewards.load(settings.reward, settings.definition)
    if not isinstance(reward, written.Written):
        return []
    found = card(reward.program, settings, strict.value(values, "gates", Gates))
    return [*(f"refused, {one}" for one in found.reasons), *found.flags]


def rules_of(values: Mapping[str, Any]) -> ProgramRules:
    """The language of rewards and its judge, for a composed config."""
    return program_rules(settings_from(dict(values)), strict.value(values, "gates", Gates))


def _with_agent(run: Run, words: list[str], command: str) -> str:
    """The command that begins a run of a run's settings, changed by words, with its agent."""
    typed = run.manifest().get("command")
    own = [str(word) for word in typed if "=" in str(word)] if isinstance(typed, list) else []
    own = own or [f"cams=[{','.join(map(str, run.config()['cams']))}]"]
    new = [*words, f"init={run.folder}", "label=more"]
    replaced = {word.partition("=")[0].lstrip("+") for word in new} | _OF_ONE_RUN
    kept = [word for word in own if word.partition("=")[0].lstrip("+") not in replaced]
    return f"{command} {shlex.join([*kept, *new])}"


def task_note(task: Task) -> dict[str, Any]:
    """What studies need of a task, as plain values: they read files and import no task."""
    return {
        "name": task.name,
        "goal": task.goal,
        "columns": [*task.columns],
        "phases": [[phase.name, phase.ends] for phase in task.phases],
        "cheat": task.cheat is not None,
    }


def _check_same(run: Run, values: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` if a run that exists has other settings than those asked for.

    A key that its config lacks is one that came later: the run has its default.
    """
    settings = []
    for job in (checked_job(run.config()), checked_job(values)):
        # An amount that is left out is none.
        wrong = (job.env.disturb.amounts, job.env.disturb.ramp)
        own = {"env": None, "disturb": wrong, "engine": vars(job.env.engine)}
        settings.append({**vars(job), **vars(job.env), **own})
    if other := differing(settings[0], settings[1], _OF_NO_CONSEQUENCE):
        raise ValueError(
            f"{run.folder} exists with another {other}; choose another label= or"
            " study=, or replace it with overwrite=true, which keeps it under a number"
        )
