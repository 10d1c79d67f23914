"""Which run a command line means: a new one, the rest of one, or one that is done."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.config.strict import OneOf, check_names
from needlehoop.envs.settings import Settings, settings_from
from needlehoop.learning.evaluate import load_agent, which_policy
from needlehoop.learning.job import Job, Steps, checked_job, typed_job
from needlehoop.learning.networks import check_same
from needlehoop.learning.subject import flown_job
from needlehoop.rewards import program_reward
from needlehoop.runs.files import CHECKPOINT, CONFIG
from needlehoop.runs.machine import held, provenance
from needlehoop.runs.run import Run
from needlehoop.tasks.contract import Task
from needlehoop.vlm.config import KINDS, Gates, InquiryConfig
from needlehoop.vlm.gate_report import gate_report
from needlehoop.vlm.inquiry import Inquiry
from needlehoop.vlm.writing import ProgramRules, program_rules

_OF_NO_CONSEQUENCE = {
    *("results", "logger", "wandb", "checkpoint_every", "weights"),
    # ``_deciding`` compares their values one by one.
    *("env", "engine"),
}
"""Settings that may change when a run goes on: they do not affect its results."""


@dataclass(frozen=True)
class Options:
    """What to do with a run that exists, as ``conf/config.yaml`` explains."""

    resume: str | None
    overwrite: bool
    existing: Annotated[str, OneOf("auto", "stop", "resume")]
    until: Steps | None
    trust: bool
    objective: str
    """A number of the final evaluation, for a search."""
    gates: Gates


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


def checked(values: Mapping[str, Any]) -> tuple[Options, Job]:
    """A composed config as a new run's options and job; a program may still be missing.

    A job whose reward is a model's program has no reward yet.
    """
    options = strict.as_type(values, Options)
    inquiry(values)
    is_program = "program" in strict.value(values, "reward", Mapping[str, Any])
    job = typed_job({**values, **({"reward": rewards.NONE} if is_program else {})})
    measured = (*job.env.definition.columns, "return", "return_human")
    check_names("objective", [options.objective], measured)
    return options, job


@contextmanager
def open_session(values: dict[str, Any], overrides: list[str], command: str) -> Iterator[Session]:
    """The run that a composed config asks for; its folder is made.

    No other process writes into the folder until the context ends, unless the run is finished.

    Raises:
        ValueError: settings that do not go together, or a run that is in the way.
        RewardError: no model wrote a reward.
    """
    if values["resume"] is not None:
        options = strict.as_type(values, Options)
        run = Run.open(Path(str(options.resume)), "resume")
        with_agent = f"begin a run with its agent: init={run.folder} label=more"
        if run.manifest().get("finished") is True:
            raise ValueError(
                f"resume: {run.folder} is finished, and its learning rate has come to its end;"
                f" {with_agent}"
            )
        beside = ("resume=", "trust=", "conf_dir=")
        if typed := [word for word in overrides if not word.startswith(beside)]:
            raise ValueError(
                f"resume: a run goes on with its own settings, without {typed[0]}; or {with_agent}"
            )
        yield from _continued(run, options.trust)
        return
    options, job = checked(values)
    ask_where_missing(values, job.env)
    reward = rewards.with_source(values["reward"])
    job = replace(job, env=replace(job.env, reward=rewards.with_function(reward)))
    folder = Path(job.results) / job.place
    if options.existing == "resume" and (folder / CONFIG).exists() and not options.overwrite:
        run = Run.open(folder)
        _check_same(run, job)
        # Its reward is the one that was typed, source included.
        yield from _continued(run, trust=True)
        return
    weights = initial_weights(job)
    loaded = rewards.load(job.env.reward, job.env.definition)
    if against := objections(loaded, job.env, options.gates):
        # A warning, no refusal: programs of others are tried as they are.
        print(f"reward: the gates on this program: {'; '.join(against)}", file=sys.stderr)
    with held(folder):
        run = Run.create(
            folder, {**values, "reward": reward}, rewards.text(loaded), options.overwrite
        )
        try:
            # Not sys.argv: a sweep's names all its runs, and a launcher's process has another.
            words = [*command.removeprefix("python ").split(), *overrides]
            run.note(task=task_note(job.env.definition), command=words, gates=against)
            yield Session(job, run, weights=weights)
        except BaseException:
            run.unmake()
            raise


def _continued(run: Run, trust: bool) -> Iterator[Session]:
    """The rest of a run, for ``open_session``; one without a checkpoint begins again."""
    job, _ = flown_job(run.config(), (), trust)
    if run.manifest().get("finished"):
        yield Session(job, run)
        return
    with held(run.folder):
        if not run.manifest().get("steps") and not (run.folder / CHECKPOINT).exists():
            run.go_on(None)
            run.note(**provenance(), wall_time=0.0, stopped=False)
            yield Session(job, run, weights=initial_weights(job))
            return
        state = run.checkpoint()
        run.go_on(state)
        run.note(steps=state["update"] * job.buffer, wall_time=state["wall_time"], stopped=False)
        yield Session(job, run, state)


def initial_weights(job: Job) -> dict[str, Any] | None:
    """The weights that a job begins with: those of the run ``job.init``, if it names one.

    Raises ``ValueError`` for no such run, one that is not trained, or has other networks.
    """
    if job.init is None:
        return None
    run = Run.open(Path(job.init), "init")
    source_job = checked_job(run.config())
    # The order of cameras and which facts are told count as well.
    for key in ("cams", "obs"):
        before, now = getattr(source_job.env, key), getattr(job.env, key)
        if before != now:
            raise ValueError(f"init: {run.folder} has {key}={before}; this run has {now}")
    # The loaded weights replace the first deviation.
    have, want = (
        replace(one.spec, precision="", network=replace(one.spec.network, sigma=1.0))
        for one in (source_job, job)
    )
    check_same(have, want, f"init: {run.folder}")
    which, _ = which_policy(run, None)
    return load_agent(run, source_job, torch.device("cpu"), which).state_dict()


def inquiry(values: Mapping[str, Any]) -> tuple[InquiryConfig, Any]:
    """How a reward would be asked for, and which model; ``ValueError`` names a wrong key."""
    asking = strict.value(values, "asking", Mapping[str, Any])
    where = {name: values[name] for name in ("results", "study")}
    config = strict.as_type({**where, **asking, "overwrite": False}, InquiryConfig)
    return config, provider_config(values["vlm"])


def provider_config(values: Any) -> Any:
    """The settings of who answers, from the group ``vlm``; errors as in ``inquiry``."""
    settings = strict.structure(values, Mapping[str, Any], "vlm")
    kind: Any = settings.get("kind")
    check_names("vlm.kind", [kind], tuple(KINDS))
    return strict.structure(settings, KINDS[kind], "vlm")


def ask_where_missing(values: dict[str, Any], settings: Settings) -> None:
    """Have a model write the program of ``reward=vlm_img`` or ``vlm_text``, if none is recorded.

    It is kept in the study's folder, where the reward looks for it. ``vlm=replay`` is not asked:
    it has only what is recorded. Raises ``RewardError`` where no program was accepted.
    """
    reward: Mapping[str, Any] = values["reward"]
    if values["vlm"]["kind"] == "replay" or program_reward.is_recorded(reward):
        return
    config, provider = inquiry(values)
    try:
        with Inquiry(settings, config, provider) as opened:
            flavour, sample = program_reward.FLAVOURS[reward["kind"]], reward["sample"]
            paths = opened.reward(flavour, rules_of(values), sample)
    except RuntimeError as error:
        raise rewards.RewardError(f"reward: no program was written: {error}") from error
    print(f"reward written to {paths[-1]}")


def objections(reward: rewards.Reward, settings: Settings, gates: Gates) -> list[str]:
    """What the gates say against a training's reward; nothing where it is no program."""
    if not isinstance(reward, program_reward.ProgramReward):
        return []
    report = gate_report(reward.program, settings, gates)
    return [*(f"refused, {reason}" for reason in report.reasons), *report.flags]


def rules_of(values: Mapping[str, Any]) -> ProgramRules:
    """The language of rewards and its judge, for a composed config."""
    return program_rules(settings_from(dict(values)), strict.value(values, "gates", Gates))


def task_note(task: Task) -> dict[str, Any]:
    """What studies need of a task, as plain values: they read files and import no task."""
    return {
        "name": task.name,
        "goal": task.goal,
        "columns": [*task.columns],
        "phases": [[phase.name, phase.ends] for phase in task.phases],
    }


def _check_same(run: Run, job: Job) -> None:
    """Raises ``ValueError`` if a run that exists has other settings than those asked for.

    A key that its config lacks was added later: the run has the default.
    """
    before, now = (_deciding(one) for one in (checked_job(run.config()), job))
    if keys := sorted(key for key in now if before[key] != now[key]):
        raise ValueError(
            f"{run.folder} exists with another {', '.join(keys)}; choose another label= or"
            " study=, or replace it with overwrite=true, which keeps it under a number"
        )


def _deciding(job: Job) -> dict[str, Any]:
    """The settings that decide a job's results, by key."""
    env = job.env
    settings = {
        key: one for key, one in {**vars(job), **vars(env)}.items() if key not in _OF_NO_CONSEQUENCE
    }
    return {
        **settings,
        # The engine's kind and threads give the same bits.
        "engine.renderer": env.engine.renderer,
        # An amount that is left out is none.
        "disturb": (env.disturb.amounts, env.disturb.ramp),
        # A function itself is in no file; its source is.
        "reward": {key: one for key, one in env.reward.items() if key != rewards.CALL},
        # A sweep composes the views of all its runs for each of them.
        "views": {seen.view: env.views[seen.view] for seen in env.cameras},
    }
