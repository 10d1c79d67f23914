"""Which run a command line means: a new one, the rest of one, or one that is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlehoop import config, rewards
from needlehoop.asking import ask_where_missing
from needlehoop.learning.job import Job
from needlehoop.runs.files import CHECKPOINT, CONFIG, EVALUATIONS, METRICS
from needlehoop.runs.run import Run

_EXISTING = ("auto", "stop", "resume")

_OF_NO_CONSEQUENCE = (
    *("resume", "overwrite", "existing", "results", "engine", "logger", "checkpoint_every"),
    *("vlm", "asking", "gates", "weights"),
)
"""Settings that a run may be gone on with others of: its results are the same."""


@dataclass(frozen=True)
class Session:
    """A run to be trained."""

    job: Job
    run: Run
    values: dict[str, Any]
    """The composed config that the run began with."""
    state: dict[str, Any] | None
    """Its checkpoint; ``None``: it begins."""

    @property
    def is_finished(self) -> bool:
        """Whether nothing is left to do."""
        return bool(self.run.manifest().get("finished"))

    @property
    def is_trained(self) -> bool:
        """Whether only the final evaluation is left to do."""
        return self.state is not None and self.state["update"] == self.job.updates


def open_session(values: dict[str, Any], overrides: list[str], command: str) -> Session:
    """The run that a composed config asks for, its folder made.

    Args:
        values: the config.
        overrides: what was typed.
        command: after what: ``python train.py`` or ``needlehoop train``.

    Raises:
        ValueError: settings that do not go together, or a run that is in the way.
        RewardError: no reward could be had from a model.
    """
    if values["existing"] not in _EXISTING:
        valid = ", ".join(_EXISTING)
        raise ValueError(f"existing: {values['existing']!r} is unknown; choose from {valid}")
    if values["resume"] is not None:
        if len(overrides) > 1:
            raise ValueError("resume: a run goes on with its own settings; give no others with it")
        session = _go_on(Run.open(Path(values["resume"])))
        if session.is_finished:
            raise ValueError(f"resume: {session.run.folder} is finished")
        return session
    # Checked without a program first, so that nobody is asked for one in vain.
    ask_where_missing(values, config.job({**values, "reward": rewards.NONE}).env)
    values = {**values, "reward": rewards.pin(values["reward"])}
    job = config.job(values)
    # One camera may be given as a word; what is kept is always a list.
    values["cams"] = list(job.env.cams)
    folder = Path(job.results) / job.place
    overwrite = values["overwrite"]
    if values["existing"] == "resume" and (folder / CONFIG).exists() and not overwrite:
        run = Run.open(folder)
        _check_same(run, values)
        if (folder / CHECKPOINT).exists() or run.manifest().get("finished"):
            return _go_on(run)
        # It ended before its first checkpoint: nothing is lost.
        overwrite = True
    reward = rewards.text(rewards.load(job.env.reward))
    run = Run.create(folder, values, reward, overwrite)
    # Not sys.argv: that of a launcher's worker says nothing, and a sweep's makes all its runs.
    run.note(command=[*command.removeprefix("python ").split(), *overrides])
    return Session(job, run, values, None)


def _go_on(run: Run) -> Session:
    values = run.config()
    session = Session(config.job(values), run, values, None)
    if session.is_finished:
        return session
    state = run.load()
    for table in (METRICS, EVALUATIONS):
        run.cut(table, state["update"])
    return Session(session.job, run, values, state)


def _check_same(run: Run, values: Mapping[str, Any]) -> None:
    """Whether a run that exists is the one that is asked for."""
    before = run.config()
    other = sorted(
        key
        for key in {*before, *values} - {*_OF_NO_CONSEQUENCE}
        if before.get(key) != _plain(values.get(key))
    )
    if other:
        raise ValueError(
            f"{run.folder} exists with another {', '.join(other)}; choose another study= or"
            " replace it with overwrite=true"
        )


def _plain(value: Any) -> Any:
    """As it comes back from YAML."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value
