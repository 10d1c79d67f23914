"""Rewards by name."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from needlehoop.config import strict
from needlehoop.rewards import called, written
from needlehoop.rewards.built_in import Sparse
from needlehoop.rewards.terms import Reward
from needlehoop.runs.files import EXPERT, check_name
from needlehoop.runs.reading import read_yaml
from needlehoop.tasks.contract import Task
from needlehoop.tasks.registry import conf_of

REWARDS = ("human", "sparse")
"""Rewards that are classes. Other kinds are programs (``written``) or functions (``called``)."""

NONE = {"kind": "sparse", "success": 1.0}
"""The config of a reward for environments whose reward nobody reads."""


def load(config: Mapping[str, Any], task: Task) -> Reward:
    """A reward from its config: ``kind``, the values of that kind, and maybe a ``name``.

    Args:
        config: of the reward.
        task: whose human reward, goal and signals are meant.

    Raises:
        ValueError: an unknown kind, invalid values, an invalid name, or Python code that was not
            allowed.
    """
    _check_kind(config)
    values = _unnamed(config)
    if called.is_called(values):
        return called.load(values)
    if values["kind"] in written.KINDS:
        return written.load(values, task.signals)
    if values.pop("kind") == "sparse":
        return Sparse.load(values, task.goal)
    return strict.structure(values, task.human, "reward")


def reference_reward(task: Task) -> Reward:
    """A task's human reward with its default values. Policies are compared by its return.

    It is the same for all policies, whatever they were trained on.
    """
    return load(read_yaml(conf_of(task.name) / f"reward/human/{task.name}.yaml"), task)


def check(config: Mapping[str, Any], task: Task) -> None:
    """Check a reward's config without running its code. Errors as in ``load``."""
    _check_kind(config)
    if called.is_called(config):
        called.check(config)
    else:
        load(config, task)


def allow(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config of a reward that somebody typed, ready for ``load``."""
    _check_kind(config)
    return called.allow(config) if called.is_called(config) else dict(config)


def recall(config: Mapping[str, Any], trust: bool) -> dict[str, Any]:
    """The config of a reward that was read from a run's files, ready for ``load``.

    Raises:
        ValueError: it names Python code, and ``trust`` is false.
    """
    _check_kind(config)
    return called.recall(config, trust) if called.is_called(config) else dict(config)


def pin(config: Mapping[str, Any]) -> dict[str, Any]:
    """A reward's config with the text of its program or function, for a run to keep.

    Raises:
        ValueError: as in ``load``.
    """
    values = _unnamed(config)
    kept = called.pin(values) if values.get("kind") == called.KIND else written.pin(values)
    return {**kept, **{key: config[key] for key in config if key not in values}}


def text(reward: Reward) -> str:
    """A reward for the record: its values or its origin, then its source."""
    if isinstance(reward, written.Written | called.Called):
        return reward.text()
    return f"{reward!r}\n\n{inspect.getsource(type(reward))}"


def _check_kind(config: Mapping[str, Any]) -> None:
    kind = config.get("kind")
    valid = (*REWARDS, *written.KINDS, called.KIND, *called.kinds())
    if not isinstance(kind, str) or kind not in valid:
        raise ValueError(f"reward.kind: {kind!r} is unknown; choose from {', '.join(valid)}")
    # A run's folder is called by its reward's name.
    name = strict.structure(config.get("name"), str | None, "reward.name")
    if name is not None:
        check_name("reward.name", name)
        if name in {*valid, EXPERT} - {kind}:
            raise ValueError(
                f"reward.name: {name!r} means another reward; choose a name of your own"
            )


def _unnamed(config: Mapping[str, Any]) -> dict[str, Any]:
    """What the reward itself is made from."""
    return {key: value for key, value in config.items() if key != "name"}
