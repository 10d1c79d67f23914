"""How several programs for the same cameras differ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import rankdata

from needlehoop.rewards.written import FIRST
from needlehoop.study.report.table import Table


@dataclass(frozen=True)
class Sample:
    """An accepted program: its gates' figures, and its values at the recorded moments."""

    card: Mapping[str, Any]
    values: Sequence[float]

    def gap(self, to: str) -> float:
        """The expert's mean final value less that of ``random`` or ``cheat``."""
        return self.card["expert"] - self.card[to]


def comparison(name: str, samples: Mapping[int, Sample]) -> Table:
    """A row for each sample: its gaps, and how far its values rank moments as others' do.

    Args:
        name: of the table's file.
        samples: by number.
    """
    numbers = sorted(samples)
    rows = [
        (
            str(number),
            *(f"{samples[number].gap(to):.3f}" for to in ("random", "cheat")),
            f"{100 * samples[number].card['paid']:.1f}",
            *(_rho(samples[number].values, samples[other].values) for other in numbers),
        )
        for number in numbers
    ]
    head = ("sample", "expert - random", "expert - cheat", "paid, %")
    head += tuple(f"rho with {number}" for number in numbers)
    widest = {to: max(numbers, key=lambda n: samples[n].gap(to)) for to in ("random", "cheat")}
    note = (
        "rho: Spearman's, of the values over the recorded trajectories. The expert stands out most"
        f" from random actions in sample {widest['random']}, from cheating in sample"
        f" {widest['cheat']}. Trained on: sample {FIRST}, or that of reward.sample=."
    )
    return Table(name, "Samples compared", head, tuple(rows), note)


def _rho(a: Sequence[float], b: Sequence[float]) -> str:
    """Spearman's rank correlation; nothing where one side is constant."""
    x, y = (rankdata(side) - (len(side) + 1) / 2 for side in (a, b))
    size = math.sqrt(float((x**2).sum() * (y**2).sum()))
    return f"{float((x * y).sum()) / size:.3f}" if size else ""
