"""What two cameras, depth, segmentation and the pair of side views are worth, over all sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.stats import t as student

from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.report.table import Table
from needlehoop.study.stats.measures import RETURN, SUCCESS, TRAINING, Measure, middles

_LEVEL = 0.95

_MEASURES = (RETURN, SUCCESS, TRAINING)

_TRAITS: dict[str, Callable[[frozenset[str]], bool]] = {
    "two cameras, not one": lambda cams: len(cams) == 2,
    "front and side views, not the default": lambda cams: {"front", "side"} <= _views(cams),
    "depth in a camera": lambda cams: bool({"dep", "segdep"} & _renderings(cams)),
    "segmentation in a camera": lambda cams: bool({"seg", "segdep"} & _renderings(cams)),
}
"""Colour alone, from one default view, has none of them."""


def effects(findings: Findings) -> Table:
    """A row for each trait: its effect on each measure, by least squares over the sets.

    Each set counts once, by its value over its seeds. Intervals are Student's over what the
    traits leave unexplained; traits that the sets cannot tell apart are left out.
    """
    results = [result for result in findings.ranked if result.success is not None]
    traits = _told_apart(results)
    free = len(results) - len(traits) - 1
    rows = []
    if traits and free > 0:
        design = _design(results, traits)
        columns = [_column(results, design, middles(findings, one), one) for one in _MEASURES]
        for number, trait in enumerate(traits, start=1):
            cells = [own[number] for own in columns]
            having = sum(_has(result, trait) for result in results)
            rows.append((trait, *cells, f"{having} of {len(results)}"))
    head = ("trait", *(f"{one.name} (95 %)" for one in _MEASURES), "sets that have it")
    note = (
        "A linear model over the sets: what a trait adds, the others held. Intervals that hold"
        " zero say nothing; with few sets or seeds most do."
    )
    return Table("effects", "What helps", head, tuple(rows), note)


def _column(
    results: list[Result], design: np.ndarray, values: Mapping[str, float], measure: Measure
) -> list[str]:
    """Each coefficient with its interval; empty where a set has no such value."""
    if len(values) < len(results):
        return [""] * design.shape[1]
    found = np.array([values[one.cameras] for one in results])
    middle, half = _least_squares(design, found, len(results) - design.shape[1])
    form = f"+.{measure.digits}f"
    return [
        f"{at:{form}} ({at - wide:{form}} to {at + wide:{form}})"
        for at, wide in zip(middle, half, strict=True)
    ]


def _told_apart(results: list[Result]) -> list[str]:
    """Traits of which each adds something that the ones before it do not say."""
    kept: list[str] = []
    for trait in _TRAITS:
        if results and np.linalg.matrix_rank(_design(results, [*kept, trait])) == len(kept) + 2:
            kept.append(trait)
    return kept


def _design(results: list[Result], traits: list[str]) -> np.ndarray:
    """``(sets, 1 + traits)``: ones, then whether a set has each trait."""
    return np.array([[1.0, *(float(_has(one, t)) for t in traits)] for one in results])


def _has(result: Result, trait: str) -> bool:
    return _TRAITS[trait](frozenset(result.cameras.split("+")))


def _least_squares(
    design: np.ndarray, values: np.ndarray, free: int
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and half-widths of their intervals, ``(1 + traits,)`` each."""
    inverse = np.linalg.inv(design.T @ design)
    middle = inverse @ design.T @ values
    left = values - design @ middle
    errors = np.sqrt(np.diag(inverse) * (left @ left) / free)
    return middle, errors * float(student.ppf(0.5 + _LEVEL / 2, free))


def _views(cams: frozenset[str]) -> set[str]:
    return {name.partition("_")[2] for name in cams}


def _renderings(cams: frozenset[str]) -> set[str]:
    return {name.partition("_")[0] for name in cams}
