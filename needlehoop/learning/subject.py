"""A run's policy as a controller, and its environment with some settings changed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from needlehoop import rewards
from needlehoop.config.changing import changed
from needlehoop.envs.controllers import MakeController
from needlehoop.envs.settings import Settings, import_task
from needlehoop.learning.evaluate import acting, check_seed, load_agent, which_policy
from needlehoop.learning.job import Job, checked_job
from needlehoop.learning.networks import check_same
from needlehoop.runs.run import Run


def of_run(
    folder: Path,
    words: Iterable[str],
    seed: int | None,
    device: torch.device,
    trust: bool,
    command: str,
    later: int = 0,
) -> tuple[Settings, MakeController]:
    """A run's environment on episodes that it was not trained on, and its agent.

    Args:
        folder: the run's.
        words: settings of the environment to be changed.
        seed: of the episodes; ``None``: of the final evaluation, plus ``later``.
        trust: whether Python code that the run's files name may run.
        command: for the error about an unknown key, which lists the command's keys too.

    Raises:
        ValueError: no such run, or settings that its agent could not act under.
    """
    run = Run.open(folder)
    job, _ = flown_job(run.config(), words, trust, command)
    seed = job.evaluation.final_seed + later if seed is None else seed
    check_seed(job, seed)
    agent = load_agent(run, job, device, which_policy(run, None)[0])
    return replace(job.env, seed=seed), acting(agent.actor)


def flown_job(
    recorded: Mapping[str, Any], words: Iterable[str], trust: bool, command: str | None = None
) -> tuple[Job, dict[str, Any]]:
    """The job of a run's config with its environment changed, and the new values by key.

    ``words``: changes, as on the command line. Python code that the run's files name runs only
    with ``trust``; a reward that is typed may always run.

    Raises:
        ValueError: code without ``trust``, a word that is wrong, or one that changes what the
            agent's networks were made for.
    """
    changes = list(words)
    import_task(recorded, trust)
    original = checked_job(recorded)
    values, new_values = changed(recorded, changes, command)
    job = checked_job(values)
    check_same(original.spec, job.spec, ", ".join(new_values))
    is_typed = any(word.lstrip("+").startswith("reward=") for word in changes)
    paid = (
        rewards.with_function(job.env.reward)
        if is_typed
        else rewards.with_trusted_function(job.env.reward, trust)
    )
    return replace(job, env=replace(job.env, reward=paid)), new_values
