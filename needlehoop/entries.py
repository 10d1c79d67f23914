"""What ``gymnasium.make`` and ``gymnasium.make_vec`` call for ``needlehoop/NeedleHoop-v0``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from needlehoop.gym.env import METADATA, GymnasiumEnv
from needlehoop.gym.vector import GymnasiumVectorEnv
from needlehoop.making import settings

PAIR = ("dep_front", "seg_side")
"""What is seen if nothing is said: the cameras of the README's first run."""


def single(
    cams: str | Iterable[str] = PAIR,
    reward: str = "human",
    task: str | None = None,
    obs: str | None = None,
    overrides: Iterable[str] = (),
    **kwargs: Any,
) -> GymnasiumEnv:
    """One environment.

    Args:
        cams: cameras, each ``<rendering>_<view>``.
        reward: an option of ``conf/reward``.
        task: an option of ``conf/task``.
        obs: an option of ``conf/obs``.
        overrides: any other setting, as on the command line: ``["obs.frame_stack=3"]``.
        kwargs: as in ``GymnasiumEnv``: ``channels``, ``render_mode``, ``render_size``.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    return GymnasiumEnv(settings(cams, reward, overrides, task=task, obs=obs), **kwargs)


# Gymnasium reads it before the call, to wrap environments for modes that they do not have.
single.metadata = METADATA  # pyright: ignore[reportFunctionMemberAccess]


def batch(
    num_envs: int,
    cams: str | Iterable[str] = PAIR,
    reward: str = "human",
    task: str | None = None,
    obs: str | None = None,
    overrides: Iterable[str] = (),
    **kwargs: Any,
) -> GymnasiumVectorEnv:
    """``num_envs`` environments; arguments as in ``single``, and ``autoreset_mode``."""
    built = settings(cams, reward, overrides, task=task, obs=obs, num_envs=num_envs)
    return GymnasiumVectorEnv(built, **kwargs)
