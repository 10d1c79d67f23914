"""What a checkpoint must hold for a job to go on from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.learning.agent import Agent
from needlehoop.learning.collectors import LabellingCollector
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.hyperparameters import DaggerConfig
from needlehoop.learning.job import Job
from needlehoop.learning.ppo import Ppo

_PPO, _DAGGER = "ppo", "dagger"

_PARTS = {
    _PPO: {_PPO: dict, "env": dict, "rng": Tensor},
    _DAGGER: {_DAGGER: dict, "lessons": dict, "rng": Tensor},
}
"""Of a learner's state, by method."""


def check_state(path: Path, state: Mapping[str, Any], job: Job) -> None:
    """That a state is one of the job's, as far as can be told before anything is built.

    Args:
        path: of the checkpoint.
        state: ``update``, ``wall_time`` and ``learner``.
        job: of the run.

    Raises:
        ValueError: it is not; says which part.
    """
    update, wall = state.get("update"), state.get("wall_time")
    learner = state.get("learner")
    if type(update) is not int or not 1 <= update <= job.updates:
        raise _unfit(path, "update", f"{update!r} is not one of 1 to {job.updates}, as in steps")
    if isinstance(wall, bool) or not isinstance(wall, int | float) or not 0 <= wall < math.inf:
        raise _unfit(path, "wall_time", f"{wall!r} is not a time")
    if not isinstance(learner, Mapping):
        raise _unfit(path, "learner", "missing")
    method = _DAGGER if isinstance(job.algo, DaggerConfig) else _PPO
    for name, kind in _PARTS[method].items():
        if not isinstance(learner.get(name), kind):
            raise _unfit(path, f"learner.{name}", "missing")
    if learner[method].get("done_updates") != update:
        raise _unfit(path, f"learner.{method}.done_updates", f"is not {update}, as update is")


def check_learner(state: Mapping[str, Any], ppo: Ppo, env: TorchRLEnv) -> None:
    """That a learner's state fits the networks and the environment that were built for a job.

    Args:
        state: as ``Learner.state_dict`` gives it.
        ppo: not trained yet.
        env: restored afterwards: its first episodes begin here.

    Raises:
        ValueError: it does not; says where.
    """
    check_like("learner.ppo", state["ppo"], ppo.moved_state())
    env.reset()
    check_like("learner.env", state["env"], env.snapshot())
    check_like("learner.rng", state["rng"], torch.get_rng_state())


def check_imitation(
    state: Mapping[str, Any], dagger: Dagger, collector: LabellingCollector
) -> None:
    """The same for imitation; errors as in ``check_learner``."""
    check_like("learner.dagger", state["dagger"], dagger.moved_state())
    flown = collector.blank(state["dagger"]["done_updates"])
    check_like("learner.lessons", state["lessons"], {**collector.state_dict(), "flown": flown})
    check_like("learner.rng", state["rng"], torch.get_rng_state())


def check_agent(state: Mapping[str, Any], agent: Agent) -> None:
    """That a learner's state has the weights of an agent; errors as in ``check_learner``."""
    method = _PPO if _PPO in state else _DAGGER
    own = state.get(method)
    found = own.get("agent") if isinstance(own, Mapping) else None
    check_like(f"learner.{method}.agent", found, agent.state_dict())


def check_like(path: str, found: Any, like: Any) -> None:
    """That two nested states have the same keys, kinds, and shapes and kinds of tensors.

    Args:
        path: where they are, for the error.
        found: as it was read.
        like: one of those that are written.

    Raises:
        ValueError: they have not; says where.
    """
    if isinstance(like, Mapping):
        if not isinstance(found, Mapping) or set(found) != set(like):
            given = set(found) if isinstance(found, Mapping) else set()
            odd = ", ".join(sorted(map(str, given ^ set(like)))[:3])
            raise ValueError(f"checkpoint: {path}: {odd or type(found).__name__} is not as written")
        for key, value in like.items():
            check_like(f"{path}.{key}", found[key], value)
    elif isinstance(like, list | tuple):
        if not isinstance(found, list | tuple) or len(found) != len(like):
            raise ValueError(f"checkpoint: {path}: is not a list of {len(like)}")
        for index, value in enumerate(like):
            check_like(f"{path}.{index}", found[index], value)
    elif isinstance(like, Tensor):
        if not isinstance(found, Tensor) or (found.shape, found.dtype) != (like.shape, like.dtype):
            raise ValueError(
                f"checkpoint: {path}: {_told(found)} in the place of {_told(like)}; it is of"
                " another run"
            )
        if found.is_floating_point() and not bool(torch.isfinite(found).all()):
            raise ValueError(f"checkpoint: {path}: has values that are not finite")
    elif type(found) is not type(like) and like is not None:
        raise ValueError(f"checkpoint: {path}: {found!r:.60} in the place of {like!r:.60}")


def _told(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"{str(value.dtype).removeprefix('torch.')} of {tuple(value.shape)}"
    return type(value).__name__


def _unfit(path: Path, key: str, reason: str) -> ValueError:
    return ValueError(
        f"{path} does not fit its run: {key}: {reason}; put it back, or begin the run again with"
        " overwrite=true, which keeps this one under a number"
    )
