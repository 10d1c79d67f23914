"""An environment's settings from names, or from a run: for ``make_env`` and the like."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.learning.subject import flown_job
from needlehoop.runs.run import Run


def settings(
    cams: str | Iterable[str],
    reward: str | Callable[..., Any],
    overrides: str | Iterable[str],
    **more: Any,
) -> Settings:
    """Settings from the arguments of ``needlehoop.make_env``; errors as there.

    Args:
        cams: a list, or a text that joins them by ``,`` or, as in tables, by ``+``.
        more: further settings; those that are ``None`` are left as they are.
    """
    cams = cams if isinstance(cams, str) else ",".join(map(str, cams))
    option = None if callable(reward) else reward
    named = {"cams": f"[{cams.replace('+', ',')}]", "reward": option, **more}
    words = [f"{key}={value}" for key, value in named.items() if value is not None]
    found = compose_settings([*words, *_listed(overrides)])
    return replace(found, reward=rewards.given(reward)) if callable(reward) else found


def settings_of(
    run: str | Path,
    num_envs: int,
    seed: int | None,
    trust: bool = False,
    overrides: str | Iterable[str] = (),
) -> Settings:
    """The settings of a run's environment; arguments and errors as in ``make_env_of``.

    Args:
        seed: ``None``: that of its final evaluation, unseen in training.
    """
    job, _ = flown_job(Run.open(Path(run)).config(), _listed(overrides), trust)
    chosen = job.evaluation.final_seed if seed is None else seed
    return replace(
        job.env,
        num_envs=strict.structure(num_envs, Count, "num_envs"),
        seed=strict.structure(chosen, Seed, "seed"),
    )


def _listed(overrides: str | Iterable[str]) -> list[str]:
    return [overrides] if isinstance(overrides, str) else list(overrides)
