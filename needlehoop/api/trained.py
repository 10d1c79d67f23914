"""From a run's folder to its policy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from needlehoop.api.released import released
from needlehoop.learning.agent import Actor
from needlehoop.learning.evaluate import load_agent, told_policy, which_policy
from needlehoop.learning.job import Job, checked_job, pick_device
from needlehoop.learning.policy import Policy
from needlehoop.learning.weights import Senses, read_actor, read_senses
from needlehoop.runs.files import POLICIES
from needlehoop.runs.run import Run

_NETWORKS = ("cams", "image_size", "obs", "encoder", "algo.network", "episode.control")
"""Settings that decide an agent's networks."""


def initial_weights(job: Job) -> dict[str, Tensor]:
    """The weights of the agent that a job is to begin with, that of the run ``job.init``.

    Raises:
        ValueError: no such run, none trained yet, or one with other networks.
    """
    assert job.init is not None
    try:
        run = Run.open(Path(job.init))
    except ValueError as error:
        raise ValueError(f"init: {error}") from error
    theirs = checked_job(run.config())
    for key in _NETWORKS:
        have, want = _setting(theirs, key), _setting(job, key)
        if have != want:
            raise ValueError(f"init: {run.folder} has {key}={have}; this run has {want}")
    which, _ = which_policy(run, None)
    return load_agent(run, theirs, torch.device("cpu"), which).state_dict()


def _setting(job: Job, key: str) -> Any:
    """A setting of a job by its key; the networks' without what their weights replace."""
    group, _, name = key.rpartition(".")
    if key == "algo.network":
        return replace(job.network, sigma=1.0)
    if key == "encoder":
        return job.encoder
    return getattr(getattr(job.env, group) if group else job.env, name)


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
