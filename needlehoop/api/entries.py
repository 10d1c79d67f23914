"""What ``gymnasium.make`` and ``make_vec`` call for ids such as ``needlehoop/Reach-v0``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from needlehoop.api.making import settings, settings_of
from needlehoop.envs.settings import Settings
from needlehoop.gym.env import METADATA, GymnasiumEnv
from needlehoop.gym.vector import GymnasiumVectorEnv
from needlehoop.runs.shipped import CONF

PAIR = ("dep_front", "seg_side")
"""Cameras by default: those of the first run in the README."""

_SETTINGS = ("cams", "reward", "task", "obs", "conf_dir", "task_dir")


def single(**kwargs: Any) -> GymnasiumEnv:
    """One environment.

    ``cams`` (``PAIR`` by default), ``reward``, ``overrides``, ``conf_dir`` and ``task_dir`` (for
    ``needlehoop/OwnTask-v0``) are as in ``needlehoop.make_env``.

    Keyword Args:
        name (str | None): of the task that the id stands for; ``None``: any.
        task (str): its variant, such as ``wide``; or an option of ``conf/task``.
        obs (str): an option of ``conf/obs``.
        run (path): a run's folder: the environment that it was trained on. ``overrides`` may
            change its conditions; no other settings go with it.
        trust (bool): whether Python code that the run's files name as its reward may run.
        kwargs (Any): as in ``GymnasiumEnv``: ``channels``, ``render_mode``, ``render_size``.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    return GymnasiumEnv(_settings(1, kwargs), **kwargs)


# Gymnasium reads it before the call, to wrap environments for modes that they do not have.
single.metadata = METADATA  # pyright: ignore[reportFunctionMemberAccess]


def batch(num_envs: int, **kwargs: Any) -> GymnasiumVectorEnv:
    """``num_envs`` environments; arguments as in ``single``, and ``autoreset_mode``."""
    return GymnasiumVectorEnv(_settings(num_envs, kwargs), **kwargs)


def _settings(num_envs: int, kwargs: dict[str, Any]) -> Settings:
    """The settings that are among ``kwargs``, which are taken out of it."""
    values = {key: kwargs.pop(key, None) for key in _SETTINGS}
    overrides: Iterable[str] = kwargs.pop("overrides", ())
    run, trust = kwargs.pop("run", None), kwargs.pop("trust", False)
    name = kwargs.pop("name", None)
    if run is not None:
        if any(value is not None for value in values.values()):
            raise ValueError(
                "run: its environment has settings of its own; change them with overrides="
            )
        return settings_of(run, num_envs, None, trust, overrides)
    cams, reward = values.pop("cams"), values.pop("reward") or "human"
    if name is not None:
        # The task itself, or a variant of it. A task of one's own has no file there.
        option = name if values["task"] is None else f"{name}/{values['task']}"
        if (CONF / "task" / f"{option}.yaml").is_file():
            values["task"] = option
    env = settings(PAIR if cams is None else cams, reward, overrides, num_envs=num_envs, **values)
    if name not in (None, env.task.name):
        raise ValueError(f"task: {values['task']!r} is of {env.task.name}, and this id is {name}'s")
    return env
