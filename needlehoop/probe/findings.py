"""What a probe found, read from its folder."""

from __future__ import annotations

from dataclasses import dataclass

from needlehoop.probe.folder import Folder
from needlehoop.probe.plan import CONSTANT, TRUTH
from needlehoop.probe.scores import Errors, Estimate, error, places, score


@dataclass(frozen=True)
class Findings:
    """Scores of combinations and baselines by name."""

    errors: dict[str, list[Errors]]
    """By seed."""
    scores: dict[str, Estimate]
    by_seed: dict[str, list[float]]
    places: dict[str, tuple[int, int]]
    """Of combinations: the best and the worst place that the intervals leave open."""

    @property
    def ranked(self) -> tuple[str, ...]:
        """Combinations, the best score first; without the baselines."""
        return tuple(sorted(self.places, key=lambda name: (-self.scores[name].value, name)))

    @property
    def seeds(self) -> int:
        """Probes that each value is a mean of."""
        return len(self.errors[CONSTANT])

    def error(self, name: str, phase: str, quantity: str) -> Estimate:
        """Mean error in mm (``grasped``: a share) over held-out episodes."""
        return error(self.errors[name], phase, quantity)


def read_findings(folder: Folder, seeds: int) -> Findings:
    """Everything in a folder that has been probed with every seed.

    Raises:
        ValueError: a file that is not a probe's.
    """
    found = {
        name: [folder.load(seed, name) for seed in range(seeds)] for name in folder.names(seeds)
    }
    blind = found[CONSTANT]
    scores = {name: score(own, blind) for name, own in found.items()}
    by_seed = {
        name: [score([one], [other]).value for one, other in zip(own, blind, strict=True)]
        for name, own in found.items()
    }
    cameras = {name: value for name, value in scores.items() if name not in (TRUTH, CONSTANT)}
    return Findings(found, scores, by_seed, places(cameras))
