"""Settings of environments from names or from a run, and the policies of runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.learning.evaluate import load_agent, policy_in_words, which_policy
from needlehoop.learning.job import checked_job, pick_device
from needlehoop.learning.networks import Actor, PolicySpec
from needlehoop.learning.policy import read_actor, read_spec
from needlehoop.learning.subject import flown_job
from needlehoop.runs.files import POLICIES
from needlehoop.runs.run import Run


def settings(
    cams: str | Iterable[str],
    reward: str | Callable[..., Any],
    overrides: Iterable[str],
    **more: Any,
) -> Settings:
    """Settings from the arguments of ``needlehoop.make_env``; errors as there.

    ``cams`` may be a text that joins them by ``,`` or, as in tables, by ``+``.
    """
    cams = cams if isinstance(cams, str) else ",".join(cams)
    option = None if callable(reward) else reward
    named = {"cams": f"[{cams.replace('+', ',')}]", "reward": option, **more}
    words = [f"{key}={value}" for key, value in named.items() if value is not None]
    found = compose_settings([*words, *overrides])
    return replace(found, reward=rewards.given(reward)) if callable(reward) else found


def settings_of(
    run: str | Path, num_envs: int, seed: int | None, trust: bool, overrides: Iterable[str]
) -> Settings:
    """The settings of a run's environment; arguments and errors as in ``make_env_of``."""
    job, _ = flown_job(Run.open(Path(run)).config(), overrides, trust)
    chosen = job.evaluation.final_seed if seed is None else seed
    return replace(
        job.env,
        num_envs=strict.structure(num_envs, Count, "num_envs"),
        seed=strict.structure(chosen, Seed, "seed"),
    )


def actor_in(
    run: str | Path, device: str, policy: str | None = None, precision: str | None = None
) -> tuple[PolicySpec, Actor, str]:
    """What a run's policy sees, the policy, and which it is in words.

    It is read from its file, and the last one from the checkpoint where it has no file. Arguments
    and errors as in ``needlehoop.load_policy``; ``precision`` of the convolutions is the run's by
    default.
    """
    where, chosen = Path(run), pick_device(device)
    other = {} if precision is None else {"precision": precision}
    weights, origin = where, str(where)
    if where.is_dir():
        opened = Run(where)
        which, steps = which_policy(opened, policy)
        weights, origin = where / POLICIES[which], f"{policy_in_words(which, steps)}, of {where}"
        if not weights.exists():
            job = replace(checked_job(opened.config()), **other)
            return job.spec, load_agent(opened, job, chosen).actor, origin
    elif policy is not None:
        raise ValueError(f"policy: {where} is a policy already; choose one of a run's folder")
    spec = replace(read_spec(weights), **other)
    return spec, read_actor(weights, spec, chosen), origin
