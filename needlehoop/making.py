"""From names to an environment's settings: what ``make_env`` and ``gymnasium.make`` share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from needlehoop import config
from needlehoop.envs.settings import Settings
from needlehoop.runs.files import listed


def settings(
    cams: str | Iterable[str], reward: str, overrides: Iterable[str], **more: Any
) -> Settings:
    """Settings from arguments and overrides.

    Args:
        cams: cameras, each ``<rendering>_<view>``.
        reward: an option of ``conf/reward``.
        overrides: any other setting, as on the command line.
        more: further settings; those that are ``None`` are left as they are.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    given = [f"{key}={value}" for key, value in more.items() if value is not None]
    words = [f"cams=[{','.join(listed(cams))}]", f"reward={reward}", *given, *overrides]
    return config.settings(words)
