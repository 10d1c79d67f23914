"""Finds a controller and its environment: a run's policy, or a script."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from needlehoop import rewards
from needlehoop.config.changing import changed
from needlehoop.config.strict import check_names
from needlehoop.disturbances.axes import Disturb
from needlehoop.envs.controllers import MakeController, by_name, controllers
from needlehoop.envs.settings import Settings, compose_settings, import_task
from needlehoop.learning.evaluate import acting, check_seed, load_agent, which_policy
from needlehoop.learning.job import Job, checked_job
from needlehoop.learning.networks import check_same
from needlehoop.runs.run import Run


def subject(
    name: str, words: Iterable[str], seed: int | None, device: torch.device, trust: bool
) -> tuple[Settings, MakeController]:
    """Find the controller that is meant, and its environment, undisturbed.

    Args:
        name: a run's folder, or the name of a scripted controller.
        words: settings of the environment; of a run, only those to be changed.
        seed: of the episodes; ``None``: of the final evaluation.
        trust: whether Python code that a run's files name may run.

    Raises:
        ValueError: no such controller, or settings that do not fit.
    """
    path = Path(name)
    if path.is_dir():
        settings, make = of_run(path, words, seed, device, trust, "stress")
        return replace(settings, disturb=Disturb()), make
    # As in a run's final evaluation by default.
    settings = compose_settings([*words, f"seed={1_000_001 if seed is None else seed}"])
    check_names("a run's folder or controller", [name], controllers(settings))
    return replace(settings, cams=()), by_name(name)


def of_run(
    folder: Path,
    words: Iterable[str],
    seed: int | None,
    device: torch.device,
    trust: bool,
    command: str,
    later: int = 0,
) -> tuple[Settings, MakeController]:
    """A run's environment on episodes that it was not trained on, and its agent; see ``subject``.

    ``command``: for the error about an unknown key, which lists the command's keys too. ``later``:
    added to the seed of the final evaluation, if none is given.
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
