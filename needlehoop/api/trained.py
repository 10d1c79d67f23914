"""From a run's folder to its policy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from needlehoop.api.released import released
from needlehoop.learning.agent import Actor
from needlehoop.learning.evaluate import load_agent, told_policy, which_policy
from needlehoop.learning.job import Job, checked_job, pick_device
from needlehoop.learning.policy import Policy
from needlehoop.learning.weights import Senses, check_same, read_actor, read_senses
from needlehoop.runs.files import POLICIES
from needlehoop.runs.run import Run


def initial_weights(job: Job) -> dict[str, Tensor]:
    """The weights of the agent that a job is to begin with, that of the run ``job.init``.

    Raises:
        ValueError: no such run, none trained yet, or one with other networks.
    """
    assert job.init is not None
    run = Run.open(Path(job.init), "init")
    theirs = checked_job(run.config())
    # The order of cameras and which facts are told count as well.
    for key in ("cams", "obs"):
        own, other = getattr(theirs.env, key), getattr(job.env, key)
        if own != other:
            raise ValueError(f"init: {run.folder} has {key}={own}; this run has {other}")
    # Their weights replace the first deviation.
    have, want = (
        replace(Senses.of(one), precision="", network=replace(one.network, sigma=1.0))
        for one in (theirs, job)
    )
    check_same(have, want, f"init: {run.folder}")
    which, _ = which_policy(run, None)
    return load_agent(run, theirs, torch.device("cpu"), which).state_dict()


def policy_of(run: str | Path, device: str, policy: str | None) -> Policy:
    """A run's policy as a function; arguments and errors as in ``actor_in``."""
    return Policy(*actor_in(run, device, policy))


def actor_in(
    run: str | Path, device: str, policy: str | None = None, precision: str | None = None
) -> tuple[Senses, Actor, str]:
    """What a run's policy sees, the policy, and which it is in words.

    It is read from its file, and the last one from the checkpoint where it has no file.

    Args:
        run: its folder; or a policy's file, which needs nothing beside it; or cameras, of
            which ``agents/`` has a released agent.
        device: ``auto``, ``cpu``, ``cuda`` or ``cuda:<k>``.
        policy: ``last``, ``best`` or ``None``, as in ``which_policy``.
        precision: of the convolutions; ``None``: the run's.

    Raises:
        ValueError: nothing there, a damaged file, or as in ``which_policy``.
    """
    where, chosen = Path(released(run)), pick_device(device)
    weights, origin = where, str(where)
    if where.is_dir():
        which, steps = which_policy(Run(where), policy)
        weights, origin = where / POLICIES[which], f"{told_policy(which, steps)}, of {where}"
    elif policy is not None:
        raise ValueError(f"policy: {where} is a policy already; choose one of a run's folder")
    if where.is_dir() and not weights.exists():
        opened = Run.open(where)
        job = checked_job(opened.config())
        job = job if precision is None else replace(job, precision=precision)
        return Senses.of(job), load_agent(opened, job, chosen).actor, origin
    senses = read_senses(weights)
    senses = senses if precision is None else replace(senses, precision=precision)
    return senses, read_actor(weights, senses, chosen), origin
