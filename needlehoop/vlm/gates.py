"""Gates: what a reward program must pass before anybody trains on it.

A gate that is not passed refuses the program; the cheat audit only flags it, unless told
to refuse, because most honest rewards cannot tell touching from threading. Every gate's
figures are on the program's ``Card``.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Gates:
    """What is asked; values in ``conf/gates``."""

    random_signals: int
    episodes: int
    """Episodes of each controller."""
    seed: int
    low: float
    high: float
    bonus: float
    """What may come on top of ``high``."""
    range: str
    """``refuse`` or ``clip``."""
    tolerance: float
    margin: float
    """Of the expert over a random policy."""
    audit: str
    """``flag`` or ``refuse``."""
    audit_margin: float
    """Of the expert over the cheat."""
    random_episodes: int
    """Of the random policy alone, to see how often it is paid."""
    paid_by: float
    """The change of the value from which on a step counts as paid."""
    paid: float
    """Share of random steps that should be."""

    def __post_init__(self) -> None:
        for key, valid in (("range", ("refuse", "clip")), ("audit", ("flag", "refuse"))):
            value = getattr(self, key)
            if value not in valid:
                raise ValueError(
                    f"gates.{key}: {value!r} is unknown; choose from {', '.join(valid)}"
                )
        least_of = {"random_signals": 1, "episodes": 1, "seed": 0, "random_episodes": 1}
        for key, least in least_of.items():
            if getattr(self, key) < least:
                raise ValueError(f"gates.{key}: {getattr(self, key)} must be at least {least}")
        if not self.paid_by > 0:
            raise ValueError(f"gates.paid_by: {self.paid_by} must be positive")
        if not 0 <= self.paid <= 1:
            raise ValueError(f"gates.paid: {self.paid} must lie in [0, 1]")
        if not self.low < self.top:
            raise ValueError(f"gates.low: {self.low} must be below high + bonus = {self.top}")

    @property
    def top(self) -> float:
        """The largest value that is allowed."""
        return self.high + self.bonus
