"""Rewards by name."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from needlehoop.config import strict
from needlehoop.rewards import called, written
from needlehoop.rewards.human import Human
from needlehoop.rewards.sparse import Sparse
from needlehoop.rewards.terms import Reward
from needlehoop.runs.files import EXPERT, check_name

REWARDS = {"human": Human, "sparse": Sparse}
"""Rewards that are classes; other kinds are programs or functions: ``written``, ``called``."""

NONE = {"kind": "sparse", "success": 1.0}
"""The config of a reward that nobody looks at."""


def load(config: Mapping[str, Any]) -> Reward:
    """A reward from its config: ``kind``, the values of that kind, and maybe a ``name``.

    Raises:
        ValueError: an unknown kind, values that are not its own, a name that can't be had, or
            Python code that was not allowed.
    """
    _check_kind(config)
    values = _unnamed(config)
    if called.is_called(values):
        return called.load(values)
    if values["kind"] in written.KINDS:
        return written.load(values)
    kind = values.pop("kind")
    return strict.structure(values, REWARDS[kind], "reward")


def check(config: Mapping[str, Any]) -> None:
    """Check a reward's config; runs none of its code. Errors as in ``load``."""
    _check_kind(config)
    if called.is_called(config):
        called.check(config)
    else:
        load(config)


def allow(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config of a reward that somebody typed, ready for ``load``."""
    _check_kind(config)
    return called.allow(config) if called.is_called(config) else dict(config)


def recall(config: Mapping[str, Any], trust: bool) -> dict[str, Any]:
    """The same for a reward that was read from a run's files.

    Raises:
        ValueError: it stands for Python code, and ``trust`` is false.
    """
    _check_kind(config)
    return called.recall(config, trust) if called.is_called(config) else dict(config)


def _check_kind(config: Mapping[str, Any]) -> None:
    values = _unnamed(config)
    kind = values.get("kind")
    valid = (*REWARDS, *written.KINDS, called.KIND, *called.kinds())
    if not isinstance(kind, str) or kind not in valid:
        raise ValueError(f"reward.kind: {kind!r} is unknown; choose from {', '.join(valid)}")
    _check_name(config.get("name"), {*valid, EXPERT} - {kind})


def pin(config: Mapping[str, Any]) -> dict[str, Any]:
    """A reward's config with what it names in it, so that a run goes on with no other reward.

    Raises:
        ValueError: as in ``load``.
    """
    values = _unnamed(config)
    kept = called.pin(values) if values.get("kind") == called.KIND else written.pin(values)
    return {**kept, **{key: config[key] for key in config if key not in values}}


def _unnamed(config: Mapping[str, Any]) -> dict[str, Any]:
    """What the reward itself is made from."""
    return {key: value for key, value in config.items() if key != "name"}


def _check_name(name: Any, taken: set[str]) -> None:
    """Whether a run's folder can call its reward so."""
    if strict.structure(name, str | None, "reward.name") is None:
        return
    check_name("reward.name", name)
    if name in taken:
        raise ValueError(f"reward.name: {name!r} means another reward; choose a name of your own")


def text(reward: Reward) -> str:
    """A reward for the record: its values, then its source; or its origin and source."""
    if isinstance(reward, written.Written | called.Called):
        return reward.text()
    return f"{reward!r}\n\n{inspect.getsource(type(reward))}"
