"""Every setting of a training, checked before anything is made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from needlehoop.config import strict
from needlehoop.config.strict import OneOf, Range, shown
from needlehoop.learning.job import Job, typed_job
from needlehoop.learning.loggers import check_installed
from needlehoop.rewards import NONE
from needlehoop.vlm.config import Gates, InquiryConfig, config_of


@dataclass(frozen=True)
class Options:
    """What to do with a run that exists; values in ``conf/config.yaml``."""

    resume: str | None
    """The folder of a run to go on with; ``None``: the other settings name the run."""
    overwrite: bool
    """Whether it is set aside and a new run begins."""
    existing: Annotated[str, OneOf("auto", "stop", "resume")]
    until: Annotated[int, Range(1, 10**15)] | None
    """Environment steps after which a run pauses."""
    trust: bool
    """Whether Python code that the files of ``resume`` name as its reward may run."""
    objective: str
    """The number of a finished run's evaluation that a search for settings makes high."""

    def __post_init__(self) -> None:
        if self.resume is not None and not self.resume.strip():
            raise ValueError("resume: give the folder of a run")


def check_options(values: Mapping[str, Any]) -> Options:
    """Check all settings of a training except its reward's program, which may not exist yet.

    Raises:
        ValueError: one of them is wrong, or they do not go together; says which.
    """
    options = strict.as_type(values, Options)
    inquiry(values)
    strict.as_type(values["gates"], Gates, "gates")
    if options.resume is None:
        written = not isinstance(values["reward"], Mapping) or "program" in values["reward"]
        job = typed_job({**values, **({"reward": NONE} if written else {})})
        measured = (*job.env.definition.columns, "return", "return_human")
        if options.objective not in measured:
            valid = ", ".join(measured)
            raise ValueError(f"objective: {options.objective!r} is unknown; choose from {valid}")
        check_memory(job)
        check_installed(job)
    return options


def inquiry(values: Mapping[str, Any]) -> tuple[InquiryConfig, Any]:
    """How a reward would be asked for, and which model; errors as in ``check_options``."""
    asking = values["asking"]
    if not isinstance(asking, Mapping):
        raise ValueError(f"asking: {shown(asking)} has no keys")
    where = {name: values[name] for name in ("results", "study")}
    asked = strict.as_type({**where, **asking, "overwrite": False}, InquiryConfig)
    return asked, provider_config(values["vlm"])


def provider_config(values: Any) -> Any:
    """Who answers, from the group ``vlm``; errors as in ``check_options``."""
    if not isinstance(values, Mapping):
        raise ValueError(f"vlm: {shown(values)} has no keys")
    return strict.as_type(
        values, config_of(strict.structure(values.get("kind"), str, "vlm.kind")), "vlm"
    )


def check_memory(job: Job) -> None:
    """Raises ``ValueError`` for a buffer of images that this machine cannot hold."""
    needed = job.buffer_bytes
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise ValueError(
            f"image_size: a buffer of num_envs={job.env.num_envs} × algo.horizon="
            f"{job.algo.horizon} steps holds {needed / 1e9:,.1f} GB, and this machine"
            f" {there / 1e9:,.1f}; choose smaller ones"
        )
