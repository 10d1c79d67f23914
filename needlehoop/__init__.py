"""needlehoop: which cameras does a surgical robot need to learn a task?

Examples:
    >>> env = needlehoop.make_env(cams=["dep_front", "seg_side"], num_envs=8)
    >>> dm = needlehoop.load(cams=["rgb_default"])
    >>> policy = needlehoop.load_policy()
    >>> gym = gymnasium.make("needlehoop:needlehoop/Reach-v0", cams=["dep_front"])
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from wrapt import register_post_import_hook

if TYPE_CHECKING:
    import dm_env

    from needlehoop.envs.torchrl_env import TorchRLEnv
    from needlehoop.gym.stable_baselines import StableBaselinesVecEnv
    from needlehoop.learning.policy import Policy

__version__ = "0.1.0"


def make_env(
    cams: Iterable[str] = (),
    reward: str | Callable[..., Any] = "human",
    num_envs: int = 8,
    seed: int = 0,
    overrides: Iterable[str] = (),
    conf_dir: str | Path | None = None,
    task: str | None = None,
    task_dir: str | Path | None = None,
) -> TorchRLEnv:
    """A batched TorchRL environment.

    Args:
        cams: cameras, each ``<rendering>_<view>``.
        reward: an option of ``conf/reward``; or a function of ``Signals`` to named terms
            ``(n,)``, or to one tensor.
        num_envs: environments in lockstep.
        seed: decides every episode.
        overrides: any other setting, as on the command line: ``["image_size=96"]``.
        conf_dir: a folder of YAML of one's own, laid out as ``conf/``: views, tasks, rewards.
        task: an option of ``conf/task``: ``wide``, ``reach``, ``reach/wide``.
        task_dir: a folder with a task of one's own, whose Python code is imported.

    Raises:
        ValueError: a bad setting; the message names its key and the valid values.
    """
    from needlehoop.api.making import settings
    from needlehoop.envs.torchrl_env import TorchRLEnv

    more = {"num_envs": num_envs, "conf_dir": conf_dir, "task": task, "task_dir": task_dir}
    return TorchRLEnv(settings(cams, reward, overrides, seed=seed, **more))


def load(
    cams: Iterable[str] = (),
    reward: str | Callable[..., Any] = "human",
    seed: int = 0,
    overrides: Iterable[str] = (),
    conf_dir: str | Path | None = None,
    task: str | None = None,
    task_dir: str | Path | None = None,
) -> dm_env.Environment:
    """A dm_control Environment; arguments as in ``make_env``."""
    from needlehoop.api.making import settings
    from needlehoop.envs import dm_control_env as interface

    more = {"conf_dir": conf_dir, "task": task, "task_dir": task_dir}
    return interface.load(settings(cams, reward, overrides, seed=seed, **more))


def make_sb3(
    cams: Iterable[str] = ("dep_front", "seg_side"),
    reward: str | Callable[..., Any] = "human",
    num_envs: int = 8,
    seed: int = 0,
    overrides: Iterable[str] = (),
    conf_dir: str | Path | None = None,
    task: str | None = None,
    task_dir: str | Path | None = None,
    render_mode: str | None = None,
) -> StableBaselinesVecEnv:
    """A VecEnv for Stable-Baselines3 (extra ``sb3``); arguments as in ``make_env``.

    ``render_mode="rgb_array"`` lets it draw the scene, as ``VecVideoRecorder`` asks for.
    """
    from needlehoop.api.making import settings
    from needlehoop.gym.stable_baselines import StableBaselinesVecEnv

    more = {"num_envs": num_envs, "conf_dir": conf_dir, "task": task, "task_dir": task_dir}
    return StableBaselinesVecEnv(settings(cams, reward, overrides, seed=seed, **more), render_mode)


def make_env_of(
    run: str | Path | None = None,
    num_envs: int = 8,
    seed: int | None = None,
    trust: bool = False,
    overrides: Iterable[str] = (),
) -> TorchRLEnv:
    """The environment that a run was trained on, as ``make_env`` gives it.

    Args:
        run: the run's folder; by default the shipped agent's.
        num_envs: environments in lockstep.
        seed: decides every episode; by default those of the run's final evaluation.
        trust: whether Python code that the run's files name as its reward may run.
        overrides: conditions to change, as on the command line: ``["task=wide"]``.

    Raises:
        ValueError: no run there, code without ``trust``, or a condition that is unknown or that
            the run's agent could not act under.
    """
    from needlehoop.api.making import settings_of
    from needlehoop.envs.torchrl_env import TorchRLEnv
    from needlehoop.runs.shipped import AGENT

    return TorchRLEnv(settings_of(run or AGENT, num_envs, seed, trust, overrides))


def load_policy(
    run: str | Path | None = None, device: str = "auto", policy: str | None = None
) -> Policy:
    """A run's trained policy: ``policy(observation)`` is the action, ``policy.origin`` which it is.

    Args:
        run: the run's folder, or a ``policy.safetensors`` alone; by default the shipped agent's.
        device: ``auto``, ``cpu``, ``cuda`` or ``cuda:<k>``.
        policy: ``last`` or ``best``; by default the last, or the best where there is no other.

    Raises:
        ValueError: no trained policy there.
    """
    from needlehoop.api.making import actor_in
    from needlehoop.learning.policy import Policy
    from needlehoop.runs.shipped import AGENT

    return Policy(*actor_in(run or AGENT, device, policy))


def __getattr__(name: str) -> ModuleType:
    # `needlehoop.robot.psm` without an import of its own, and without paying for it up front.
    if name == "psm":
        return import_module("needlehoop.robot.psm")
    raise AttributeError(f"module 'needlehoop' has no attribute {name!r}")


def _register(gymnasium: Any) -> None:
    """Tell Gymnasium of the tasks: ``needlehoop/PegTransfer-v0`` is ``peg_transfer``."""
    from needlehoop.tasks import built_in

    entries = "needlehoop.api.entries"
    for name in (*built_in(), "own_task"):
        gymnasium.register(
            f"needlehoop/{name.title().replace('_', '')}-v0",
            entry_point=f"{entries}:single",
            vector_entry_point=f"{entries}:batch",
            kwargs={"name": name} if name in built_in() else {},
        )


# Gymnasium takes 0.3 s to import, which is left to those who use it.
register_post_import_hook(_register, "gymnasium")
