"""Trained policies: of a run, or of a policy file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from needlehoop.learning.agent import Actor
from needlehoop.learning.evaluate import load_agent, told_policy, which_policy
from needlehoop.learning.job import Job, checked_job, pick_device
from needlehoop.learning.networks import PolicySpec, check_same
from needlehoop.learning.weights import read_actor, read_spec
from needlehoop.runs.files import POLICIES
from needlehoop.runs.run import Run


def initial_weights(job: Job) -> dict[str, Tensor] | None:
    """The weights that a job begins with: those of the run ``job.init``, if it names one.

    Raises:
        ValueError: no such run, none trained yet, or one with other networks.
    """
    if job.init is None:
        return None
    run = Run.open(Path(job.init), "init")
    theirs = checked_job(run.config())
    # The order of cameras and which facts are told count as well.
    for key in ("cams", "obs"):
        own, other = getattr(theirs.env, key), getattr(job.env, key)
        if own != other:
            raise ValueError(f"init: {run.folder} has {key}={own}; this run has {other}")
    # Their weights replace the first deviation.
    have, want = (
        replace(one.spec, precision="", network=replace(one.network, sigma=1.0))
        for one in (theirs, job)
    )
    check_same(have, want, f"init: {run.folder}")
    which, _ = which_policy(run, None)
    return load_agent(run, theirs, torch.device("cpu"), which).state_dict()


def actor_in(
    run: str | Path, device: str, policy: str | None = None, precision: str | None = None
) -> tuple[PolicySpec, Actor, str]:
    """What a run's policy sees, the policy, and which it is in words.

    It is read from its file, and the last one from the checkpoint where it has no file. Arguments
    as in ``needlehoop.load_policy``.

    Args:
        precision: of the convolutions; ``None``: the run's.

    Raises:
        ValueError: nothing there, a damaged file, or as in ``which_policy``.
    """
    where, chosen = Path(run), pick_device(device)
    weights, origin = where, str(where)
    if where.is_dir():
        which, steps = which_policy(Run(where), policy)
        weights, origin = where / POLICIES[which], f"{told_policy(which, steps)}, of {where}"
    elif policy is not None:
        raise ValueError(f"policy: {where} is a policy already; choose one of a run's folder")
    other = {} if precision is None else {"precision": precision}
    if where.is_dir() and not weights.exists():
        opened = Run.open(where)
        job = replace(checked_job(opened.config()), **other)
        return job.spec, load_agent(opened, job, chosen).actor, origin
    spec = replace(read_spec(weights), **other)
    return spec, read_actor(weights, spec, chosen), origin
