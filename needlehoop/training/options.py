"""Every setting of a training, checked before anything is made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Annotated, Any

from needlehoop.config import strict
from needlehoop.config.strict import OneOf, Range
from needlehoop.learning.job import Job, typed_job
from needlehoop.learning.loggers import check_installed
from needlehoop.rewards import NONE
from needlehoop.vlm.config import Gates, InquiryConfig, config_of

Steps = Annotated[int, Range(1, 10**15)]


def check_options(values: Mapping[str, Any]) -> SimpleNamespace:
    """Check all settings of a training except its reward's program, which may not exist yet.

    Returns:
        What to do with a run that exists: ``resume``, ``overwrite``, ``existing``, ``until``,
        ``trust`` and ``objective``, as ``conf/config.yaml`` explains them.

    Raises:
        ValueError: one of them is wrong, or they do not go together; says which.
    """
    options = strict.read(
        values,
        resume=str | None,
        overwrite=bool,
        existing=Annotated[str, OneOf("auto", "stop", "resume")],
        until=Steps | None,
        trust=bool,
        objective=str,
    )
    if options.resume is not None and not options.resume.strip():
        raise ValueError("resume: give the folder of a run")
    inquiry(values)
    strict.value(values, "gates", Gates)
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
    asking = strict.value(values, "asking", Mapping[str, Any])
    where = {name: values[name] for name in ("results", "study")}
    asked = strict.as_type({**where, **asking, "overwrite": False}, InquiryConfig)
    return asked, provider_config(values["vlm"])


def provider_config(values: Any) -> Any:
    """Who answers, from the group ``vlm``; errors as in ``check_options``."""
    given = strict.structure(values, Mapping[str, Any], "vlm")
    kind = strict.structure(given.get("kind"), str, "vlm.kind")
    return strict.structure(given, config_of(kind), "vlm")


def check_memory(job: Job) -> None:
    """Raises ``ValueError`` for a buffer of images that this machine cannot hold."""
    algo = job.algo
    pixels = sum(job.env.image_channels.values()) * job.env.image_size**2
    # Beside the images, the weights with Adam's moments.
    needed = max(2 * job.buffer, algo.frames) * pixels
    needed += 16 * algo.network.hidden**2 * (algo.network.layers + 1)
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise ValueError(
            f"image_size: a buffer of num_envs={job.env.num_envs} × algo.horizon="
            f"{job.algo.horizon} steps holds {needed / 1e9:,.1f} GB, and this machine"
            f" {there / 1e9:,.1f}; choose smaller ones"
        )
