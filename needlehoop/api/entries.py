"""What ``gymnasium.make`` and ``gymnasium.make_vec`` call for ``needlehoop/NeedleHoop-v0``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from needlehoop.api.making import settings, settings_of
from needlehoop.envs.settings import Settings
from needlehoop.gym.env import METADATA, GymnasiumEnv
from needlehoop.gym.vector import GymnasiumVectorEnv

PAIR = ("dep_front", "seg_side")
"""What is seen if nothing is said: the cameras of the first run in the README."""


def single(
    cams: str | Iterable[str] | None = None,
    reward: str | Callable[..., Any] | None = None,
    task: str | None = None,
    obs: str | None = None,
    overrides: Iterable[str] = (),
    conf_dir: str | Path | None = None,
    run: str | Path | None = None,
    trust: bool = False,
    **kwargs: Any,
) -> GymnasiumEnv:
    """One environment.

    Args:
        cams: cameras, each ``<rendering>_<view>``; by default ``dep_front`` and ``seg_side``.
        reward: an option of ``conf/reward``, by default ``human``; or a function of ``Signals``.
        task: an option of ``conf/task``.
        obs: an option of ``conf/obs``.
        overrides: any other setting, as on the command line: ``["obs.frame_stack=3"]``.
        conf_dir: a folder of YAML of one's own, laid out as ``conf/``.
        run: a run's folder: the environment that it was trained on, with no other settings.
        trust: whether Python code that the run's files name as its reward may run.
        kwargs: as in ``GymnasiumEnv``: ``channels``, ``render_mode``, ``render_size``.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    words = (cams, reward, task, obs, overrides, conf_dir, run, trust)
    return GymnasiumEnv(_settings(1, *words), **kwargs)


# Gymnasium reads it before the call, to wrap environments for modes that they do not have.
single.metadata = METADATA  # pyright: ignore[reportFunctionMemberAccess]


def batch(
    num_envs: int,
    cams: str | Iterable[str] | None = None,
    reward: str | Callable[..., Any] | None = None,
    task: str | None = None,
    obs: str | None = None,
    overrides: Iterable[str] = (),
    conf_dir: str | Path | None = None,
    run: str | Path | None = None,
    trust: bool = False,
    **kwargs: Any,
) -> GymnasiumVectorEnv:
    """``num_envs`` environments; arguments as in ``single``, and ``autoreset_mode``."""
    words = (cams, reward, task, obs, overrides, conf_dir, run, trust)
    return GymnasiumVectorEnv(_settings(num_envs, *words), **kwargs)


def _settings(
    num_envs: int,
    cams: str | Iterable[str] | None,
    reward: str | Callable[..., Any] | None,
    task: str | None,
    obs: str | None,
    overrides: Iterable[str],
    conf_dir: str | Path | None,
    run: str | Path | None,
    trust: bool,
) -> Settings:
    words = list(overrides)
    if run is None:
        chosen, paid = PAIR if cams is None else cams, reward or "human"
        more = {"task": task, "obs": obs, "conf_dir": conf_dir}
        return settings(chosen, paid, words, num_envs=num_envs, **more)
    if words or any(value is not None for value in (cams, reward, task, obs, conf_dir)):
        raise ValueError("run: its environment has settings of its own; give no others with it")
    return settings_of(run, num_envs, None, trust)
