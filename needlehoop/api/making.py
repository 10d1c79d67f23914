"""From names, or from a run, to an environment's settings: for ``make_env`` and its kin."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.learning.job import recorded_job
from needlehoop.runs.files import listed
from needlehoop.runs.run import Run


def settings(
    cams: str | Iterable[str],
    reward: str | Callable[..., Any],
    overrides: Iterable[str],
    **more: Any,
) -> Settings:
    """Settings from arguments and overrides.

    Args:
        cams: cameras, each ``<rendering>_<view>``; ``+`` joins them as it does in tables.
        reward: an option of ``conf/reward``; or a function of ``Signals`` to named terms.
        overrides: any other setting, as on the command line.
        more: further settings; those that are ``None`` are left as they are.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    names = [name for word in listed(cams) for name in word.split("+")]
    named = {"cams": f"[{','.join(names)}]", "reward": reward, **more}
    if callable(reward):
        del named["reward"]
    words = [f"{key}={value}" for key, value in named.items() if value is not None]
    found = compose_settings([*words, *overrides])
    return replace(found, reward=rewards.given(reward)) if callable(reward) else found


def settings_of(run: str | Path, num_envs: int, seed: int | None, trust: bool = False) -> Settings:
    """The settings of a run's environment.

    Args:
        run: its folder.
        num_envs: environments in lockstep.
        seed: of the episodes; ``None``: that of its final evaluation, unseen in training.
        trust: whether Python code that its files name as its reward may run.

    Raises:
        ValueError: no run there, no such number or seed, or code without ``trust``.
    """
    job = recorded_job(Run.open(Path(run)).config(), trust)
    chosen = job.evaluation.final_seed if seed is None else seed
    return replace(
        job.env,
        num_envs=strict.structure(num_envs, Count, "num_envs"),
        seed=strict.structure(chosen, Seed, "seed"),
    )
