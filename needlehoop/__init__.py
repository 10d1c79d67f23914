"""needlehoop: which cameras does a surgical robot need to learn a task?

>>> env = needlehoop.make_env(cams=["dep_front", "seg_side"], num_envs=8)
>>> dm = needlehoop.load(cams=["rgb_default"])
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from needlehoop.runs.files import listed

if TYPE_CHECKING:
    import dm_env

    from needlehoop.envs.torchrl_env import NeedleHoopEnv

__version__ = "0.1.0"


def make_env(
    cams: Iterable[str] = (),
    reward: str = "human",
    num_envs: int = 8,
    seed: int = 0,
    overrides: Iterable[str] = (),
) -> NeedleHoopEnv:
    """A batched TorchRL environment.

    Args:
        cams: cameras, each ``<rendering>_<view>``.
        reward: an option of ``conf/reward``.
        num_envs: environments in lockstep.
        seed: decides every episode.
        overrides: any other setting, as on the command line: ``["task=wide"]``.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    from needlehoop.config import settings
    from needlehoop.envs.torchrl_env import NeedleHoopEnv

    given = [f"reward={reward}", f"num_envs={num_envs}", f"seed={seed}", _list("cams", cams)]
    return NeedleHoopEnv(settings([*given, *overrides]))


def load(
    cams: Iterable[str] = (),
    reward: str = "human",
    seed: int = 0,
    overrides: Iterable[str] = (),
) -> dm_env.Environment:
    """A dm_control Environment; arguments as in ``make_env``."""
    from needlehoop.config import settings
    from needlehoop.envs import dm_control_env as interface

    given = [f"reward={reward}", f"seed={seed}", _list("cams", cams)]
    return interface.load(settings([*given, *overrides]))


def __getattr__(name: str) -> ModuleType:
    # `needlehoop.robot.psm` without an import of its own, and without paying for it up front.
    if name == "psm":
        return import_module("needlehoop.robot.psm")
    raise AttributeError(f"module 'needlehoop' has no attribute {name!r}")


def _list(key: str, names: Iterable[str]) -> str:
    return f"{key}=[{','.join(listed(names))}]"
