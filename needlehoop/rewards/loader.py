"""Rewards by name."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Protocol

from torch import Tensor

from needlehoop.rewards.human import Human
from needlehoop.rewards.sparse import Sparse
from needlehoop.signals import Signals

REWARDS = {"human": Human, "sparse": Sparse}


class Reward(Protocol):
    """Named terms of a potential; the same names at every call."""

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name."""
        ...


def load(config: Mapping[str, Any]) -> Reward:
    """A reward from its config: ``kind`` and the values of that kind.

    Raises:
        ValueError: an unknown kind, or values that are not its own.
    """
    values = dict(config)
    kind = values.pop("kind", None)
    if kind not in REWARDS:
        raise ValueError(f"reward.kind: {kind!r} is unknown; choose from {', '.join(REWARDS)}")
    names = {field.name for field in fields(REWARDS[kind])}
    if names != set(values):
        odd = ", ".join(sorted(names ^ set(values)))
        raise ValueError(
            f"reward: {odd} missing or unknown; {kind} takes {', '.join(sorted(names))}"
        )
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"reward.{name}: {value!r} is not a number")
    return REWARDS[kind](**values)


def text(reward: Reward) -> str:
    """A reward for the record: its values, then its source."""
    return f"{reward!r}\n\n{inspect.getsource(type(reward))}"


def potential(terms: Mapping[str, Tensor]) -> Tensor:
    """Sum of the terms, in their order, ``(n,)``."""
    total, *rest = terms.values()
    for term in rest:
        total = total + term
    return total
