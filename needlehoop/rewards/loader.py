"""Rewards by name."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from needlehoop import strict
from needlehoop.rewards import called, written
from needlehoop.rewards.human import Human
from needlehoop.rewards.sparse import Sparse
from needlehoop.rewards.terms import Reward

REWARDS = {"human": Human, "sparse": Sparse}
"""Rewards that are classes; other kinds are programs or functions: ``written``, ``called``."""

NONE = {"kind": "sparse", "success": 1.0}
"""The config of a reward that nobody looks at."""


def load(config: Mapping[str, Any]) -> Reward:
    """A reward from its config: ``kind`` and the values of that kind.

    Raises:
        ValueError: an unknown kind, or values that are not its own.
    """
    values = dict(config)
    kind = values.pop("kind", None)
    if isinstance(kind, str) and kind in written.KINDS:
        return written.load(config)
    if not isinstance(kind, str) or kind not in {*REWARDS, called.KIND, *called.kinds()}:
        valid = ", ".join((*REWARDS, *written.KINDS, called.KIND, *called.kinds()))
        raise ValueError(f"reward.kind: {kind!r} is unknown; choose from {valid}")
    if kind not in REWARDS:
        return called.load(config)
    return strict.structure(values, REWARDS[kind], "reward")


def pin(config: Mapping[str, Any]) -> dict[str, Any]:
    """A reward's config with what it names in it, so that a run goes on with no other reward.

    Raises:
        ValueError: as in ``load``.
    """
    return called.pin(config) if config.get("kind") == called.KIND else written.pin(config)


def text(reward: Reward) -> str:
    """A reward for the record: its values, then its source; or its origin and source."""
    if isinstance(reward, written.Written | called.Called):
        return reward.text()
    return f"{reward!r}\n\n{inspect.getsource(type(reward))}"
