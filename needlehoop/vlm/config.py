"""Settings of the vlm commands: where answers are kept, and the gates for reward programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from needlehoop.config.strict import Amount, Positive, Range, Real, Seed, Share
from needlehoop.runs.files import check_folder, check_name

Samples = Annotated[int, Range(1, 10_000)]
"""How many conversations, each of which begins afresh."""


class OneOf(tuple[str, ...]):
    """The values that a text may have."""

    def check(self, value: str) -> None:
        """Raises ``ValueError`` for another."""
        if value not in self:
            raise ValueError(f"{value!r} is unknown; choose from {', '.join(self)}")


Weight = Annotated[str, OneOf(("flag", "refuse"))]
"""What failing a gate does to a program."""


@dataclass(frozen=True)
class InquiryConfig:
    """Values in ``conf/ask.yaml``."""

    results: str
    study: str
    size: Annotated[int, Range(16, 4096)]
    """Pixels of the pictures that the model is shown."""
    attempts: Annotated[int, Range(1, 1000)]
    """Answers to one question, at most."""
    overwrite: bool

    def __post_init__(self) -> None:
        check_folder("results", self.results)
        check_name("study", self.study)

    @property
    def folder(self) -> Path:
        """Where results are written."""
        return Path(self.results) / self.study / "vlm"


@dataclass(frozen=True)
class Gates:
    """Tests of a reward program before anybody trains on it; values in ``conf/gates``.

    A program that fails a gate is refused. The cheat audit and stopping short only flag a program,
    unless ``audit`` or ``stop`` is ``refuse``: most honest rewards cannot tell a good cheat, and a
    recorded conversation goes on as it did before there was a gate. A program's ``Card`` has its
    figures at all gates.
    """

    random_signals: Annotated[int, Range(1, 10_000_000)]
    episodes: Annotated[int, Range(1, 100_000)]
    """Episodes of each controller."""
    seed: Seed
    low: Real
    high: Real
    bonus: Amount
    """How much a value may exceed ``high``."""
    range: Annotated[str, OneOf(("refuse", "clip"))]
    """What happens to values outside: ``refuse`` the program, or ``clip`` them."""
    tolerance: Amount
    margin: Real
    """The least that the expert's final value must exceed a random policy's by."""
    audit: Weight
    audit_margin: Real
    """The least that the expert's final value must exceed the cheat's by."""
    stop: Weight
    stop_margin: Real
    """The least that a finished episode's final value must exceed that of one stopped short by."""
    stop_episodes: Annotated[int, Range(1, 100_000)]
    """Episodes of the teacher stopped short, for each way of doing so."""
    random_episodes: Annotated[int, Range(1, 100_000)]
    """Episodes of the random policy alone, to see how many of its steps are paid."""
    paid_by: Positive
    """A step counts as paid if it changes the value by this much."""
    paid: Share
    """The least share of random steps that must be paid."""

    def __post_init__(self) -> None:
        if not self.low < self.top:
            raise ValueError(f"gates.low: {self.low} must be below high + bonus = {self.top}")

    @property
    def top(self) -> float:
        """The largest value that is allowed."""
        return self.high + self.bonus
