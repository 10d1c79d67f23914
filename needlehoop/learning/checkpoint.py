"""What a checkpoint must hold for a job to go on from it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import torch
from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Range
from needlehoop.learning.agent import Agent
from needlehoop.learning.hyperparameters import DaggerConfig
from needlehoop.learning.job import Job
from needlehoop.runs.files import DAGGER, PPO


def check_state(path: Path, state: Mapping[str, Any], job: Job) -> Mapping[str, Any]:
    """That a state is one of the job's, as far as can be told before anything is built.

    Args:
        state: ``update``, ``wall_time`` and ``learner``.

    Returns:
        The part of the trainer: weights, optimiser, progress.

    Raises:
        ValueError: it is not; says which part.
    """
    method = DAGGER if isinstance(job.algo, DaggerConfig) else PPO
    learner, update = state.get("learner"), state.get("update")
    own = learner.get(method) if isinstance(learner, Mapping) else None
    try:
        strict.structure(update, Annotated[int, Range(1, job.updates)], "update")
        strict.structure(state.get("wall_time"), Annotated[float, Range(0.0)], "wall_time")
        if not isinstance(own, Mapping) or own.get("done_updates") != update:
            raise ValueError(f"learner.{method}: missing, or done_updates is not {update}")
    except ValueError as error:
        raise ValueError(
            f"{path} does not fit its run: {error}; put it back, or begin the run again with"
            " overwrite=true, which keeps this one under a number"
        ) from error
    return own


def load_weights(path: Path, state: Mapping[str, Any], job: Job, agent: Agent) -> None:
    """Put a checkpoint's weights into an agent of its job; errors as in ``check_state``."""
    found: Any = check_state(path, state, job).get("agent")
    check_like("agent", found, agent.state_dict())
    agent.load_state_dict(found)


def check_like(path: str, found: Any, like: Any) -> None:
    """That two nested states have the same keys, kinds, and shapes and kinds of tensors.

    Args:
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
