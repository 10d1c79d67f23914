"""Which run a command line means: a new one, the rest of one, or one that is done."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlehoop import rewards
from needlehoop.api.trained import initial_weights
from needlehoop.learning.job import Job, checked_job, typed_job
from needlehoop.learning.learner import check_state
from needlehoop.learning.subject import flown_job
from needlehoop.runs.checkpoint import Checkpoint
from needlehoop.runs.files import CHECKPOINT, CONFIG
from needlehoop.runs.lock import Lock
from needlehoop.runs.machine import provenance
from needlehoop.runs.run import Run
from needlehoop.tasks.contract import Task
from needlehoop.training.missing_reward import ask_where_missing, objections
from needlehoop.training.options import check_options

_OF_NO_CONSEQUENCE = (
    *("resume", "overwrite", "existing", "until", "results", "engine", "logger", "wandb"),
    *("checkpoint_every", "vlm", "asking", "gates", "weights", "trust", "keep", "objective"),
)
"""Settings that may change when a run is resumed: they do not affect its results."""


_OF_ONE_RUN = {"resume", "overwrite", "existing", "until"}
"""What was typed for one run, and not for another of the same settings."""


@dataclass(frozen=True)
class Session(AbstractContextManager):
    """A run to train; no other process writes into its folder until the context ends."""

    job: Job
    run: Run
    values: dict[str, Any]
    """The composed config that the run began with."""
    state: dict[str, Any] | None
    """Its checkpoint; ``None``: it begins."""
    lock: Lock | None
    """On its folder; ``None`` where nothing is left to do."""
    weights: dict[str, Any] | None = None
    """Weights of the agent that it begins with; ``None``: new ones."""

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if self.lock is not None:
            if error is not None:
                self.run.unmake()
            self.lock.release()

    @property
    def is_finished(self) -> bool:
        """Whether nothing is left to do."""
        return bool(self.run.manifest().get("finished"))

    @property
    def steps(self) -> int:
        """Environment steps that are done."""
        return 0 if self.state is None else self.state["update"] * self.job.buffer

    @property
    def is_trained(self) -> bool:
        """Whether only the final evaluation is left to do."""
        return self.state is not None and self.state["update"] == self.job.updates


def open_session(values: dict[str, Any], overrides: list[str], command: str) -> Session:
    """The run that a composed config asks for; its folder is made.

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
        return _continue(run, asked.trust)
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
        return _continue(run, trust=True, again=True)
    weights = None if job.init is None else initial_weights(job)
    against = objections(values, job.env)
    if against:
        # A warning, no refusal: programs of others are tried as they are.
        print(f"reward: the gates on this program: {'; '.join(against)}", file=sys.stderr)
    lock = Lock(folder)
    try:
        reward = rewards.text(rewards.load(job.env.reward, job.env.definition))
        run = Run.create(folder, _plain(values), reward, asked.overwrite)
        # Not sys.argv: a sweep's is that of all its runs, and a launcher's process has another.
        words = [*command.removeprefix("python ").split(), *overrides]
        run.note(task=task_note(job.env.definition), command=words, gates=against)
    except BaseException:
        lock.release()
        raise
    return Session(job, run, values, None, lock, weights)


def _with_agent(run: Run, words: list[str], command: str) -> str:
    """The command that begins a run of a run's settings, changed by words, with its agent."""
    typed = run.manifest().get("command")
    own = [str(word) for word in typed if "=" in str(word)] if isinstance(typed, list) else []
    own = own or [f"cams=[{','.join(map(str, run.config()['cams']))}]"]
    new = [*words, f"init={run.folder}", "label=more"]
    replaced = {word.partition("=")[0].lstrip("+") for word in new} | _OF_ONE_RUN
    kept = [word for word in own if word.partition("=")[0].lstrip("+") not in replaced]
    return f"{command} {shlex.join([*kept, *new])}"


def _continue(run: Run, trust: bool, again: bool = False) -> Session:
    """The rest of a run.

    Args:
        again: whether one that ended before its first checkpoint begins again.

    Raises:
        ValueError: something in its folder is damaged, or another process is at work there.
    """
    values = run.config()
    job, _ = flown_job(values, (), trust)
    if run.manifest().get("finished"):
        return Session(job, run, values, None, None)
    lock = Lock(run.folder)
    try:
        begun = run.manifest().get("steps")
        if again and not begun and not (run.folder / CHECKPOINT).exists():
            run.go_on(None)
            run.note(**provenance(), wall_time=0.0, stopped=False)
            weights = None if job.init is None else initial_weights(job)
            return Session(job, run, values, None, lock, weights)
        checkpoint = run.checkpoint()
        path = run.folder / CHECKPOINT
        _check_config(path, checkpoint, values)
        check_state(path, checkpoint.state, job)
        run.go_on(checkpoint)
        state = checkpoint.state
        run.note(steps=state["update"] * job.buffer, wall_time=state["wall_time"], stopped=False)
        return Session(job, run, values, state, lock)
    except BaseException:
        lock.release()
        raise


def task_note(task: Task) -> dict[str, Any]:
    """What studies need of a task, as plain values: they read files and import no task."""
    return {
        "name": task.name,
        "goal": task.goal,
        "columns": [*task.columns],
        "phases": [[phase.name, phase.ends] for phase in task.phases],
        "cheat": task.cheat is not None,
    }


def _check_config(path: Path, checkpoint: Checkpoint, values: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` if a checkpoint was trained with other settings than its run has."""
    other = _differing(checkpoint.config, values)
    if other:
        raise ValueError(
            f"{path} was trained with another {other} than {CONFIG} has now; put the"
            " file back, or begin a run of its own with study="
        )


def _check_same(run: Run, values: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` if a run that exists has other settings than those asked for.

    A key that its config lacks is one that came later: the run has its default.
    """
    jobs = [checked_job(one) for one in (run.config(), values)]
    # An amount that is left out is none.
    wrong = [(job.env.disturb.amounts, job.env.disturb.ramp) for job in jobs]
    both = zip(jobs, wrong, strict=True)
    other = _differing(
        *({**vars(job), **vars(job.env), "env": None, "disturb": own} for job, own in both)
    )
    if other:
        raise ValueError(
            f"{run.folder} exists with another {other}; choose another label= or"
            " study=, or replace it with overwrite=true, which keeps it under a number"
        )


def _differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The names of settings that differ and affect results."""
    keys = {*before, *now} - {*_OF_NO_CONSEQUENCE}
    return ", ".join(sorted(key for key in keys if _plain(before.get(key)) != _plain(now.get(key))))


def _plain(value: Any) -> Any:
    """As it comes back from YAML."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value
