"""Gates: what a reward program must pass before anybody trains on it.

A gate that is not passed refuses the program; the cheat audit only flags it, unless told
to refuse, because most honest rewards cannot tell touching from threading. Every gate's
figures are on the program's ``Card``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from needlehoop.config.strict import Amount, Positive, Range, Real, Seed, Share


@dataclass(frozen=True)
class Gates:
    """What is asked; values in ``conf/gates``."""

    random_signals: Annotated[int, Range(1, 10_000_000)]
    episodes: Annotated[int, Range(1, 100_000)]
    """Episodes of each controller."""
    seed: Seed
    low: Real
    high: Real
    bonus: Amount
    """What may come on top of ``high``."""
    range: str
    """``refuse`` or ``clip``."""
    tolerance: Amount
    margin: Real
    """Of the expert over a random policy."""
    audit: str
    """``flag`` or ``refuse``."""
    audit_margin: Real
    """Of the expert over the cheat."""
    random_episodes: Annotated[int, Range(1, 100_000)]
    """Of the random policy alone, to see how often it is paid."""
    paid_by: Positive
    """The change of the value from which on a step counts as paid."""
    paid: Share
    """Share of random steps that should be."""

    def __post_init__(self) -> None:
        for key, valid in (("range", ("refuse", "clip")), ("audit", ("flag", "refuse"))):
            value = getattr(self, key)
            if value not in valid:
                raise ValueError(
                    f"gates.{key}: {value!r} is unknown; choose from {', '.join(valid)}"
                )
        if not self.low < self.top:
            raise ValueError(f"gates.low: {self.low} must be below high + bonus = {self.top}")

    @property
    def top(self) -> float:
        """The largest value that is allowed."""
        return self.high + self.bonus
