"""An environment's settings from names, or from a run: for ``make_env`` and the like."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.config.strict import Count, Seed, shown
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.learning.subject import flown_job
from needlehoop.runs.run import Run


def settings(
    cams: str | Iterable[str],
    reward: str | Callable[..., Any],
    overrides: Iterable[str],
    **more: Any,
) -> Settings:
    """Settings from the arguments of ``needlehoop.make_env``; errors as there.

    Args:
        cams: ``+`` joins them as it does in tables.
        more: further settings; those that are ``None`` are left as they are.
    """
    chosen = cams.split(",") if isinstance(cams, str) else _texts("cams", cams)
    names = [name for word in chosen for name in word.split("+")]
    option = None if callable(reward) else reward
    named = {"cams": f"[{','.join(names)}]", "reward": option, **more}
    words = [f"{key}={value}" for key, value in named.items() if value is not None]
    found = compose_settings([*words, *_texts("overrides", overrides)])
    return replace(found, reward=rewards.given(reward)) if callable(reward) else found


def settings_of(
    run: str | Path,
    num_envs: int,
    seed: int | None,
    trust: bool = False,
    overrides: Iterable[str] = (),
) -> Settings:
    """The settings of a run's environment; arguments and errors as in ``make_env_of``.

    Args:
        seed: ``None``: that of its final evaluation, unseen in training.
    """
    if not isinstance(run, str | Path):
        raise ValueError(f"run: {shown(run)} is no folder")
    words = _texts("overrides", overrides)
    job, _ = flown_job(Run.open(Path(run)).config(), words, trust)
    chosen = job.evaluation.final_seed if seed is None else seed
    return replace(
        job.env,
        num_envs=strict.structure(num_envs, Count, "num_envs"),
        seed=strict.structure(chosen, Seed, "seed"),
    )


def _texts(key: str, given: Any) -> list[str]:
    """Raises ``ValueError`` for anything but a list of texts."""
    is_list = isinstance(given, Iterable) and not isinstance(given, str | bytes | Mapping)
    found: list[Any] = list(given) if is_list else []
    if not is_list or not all(isinstance(one, str) for one in found):
        raise ValueError(f"{key}: {shown(given)} is no list of texts")
    return found
