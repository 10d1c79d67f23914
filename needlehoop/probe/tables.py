"""The probe's tables: ranking, phases, agreement with other rankings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations

from needlehoop.probe.findings import Findings
from needlehoop.probe.frames import PHASES
from needlehoop.probe.plan import CONSTANT, TRUTH
from needlehoop.probe.scores import NEEDED, QUANTITIES, Estimate
from needlehoop.study.data import paper
from needlehoop.study.data.combinations import LISTS, label
from needlehoop.study.report.table import Table
from needlehoop.study.stats.agreement import agreement

PHASES_TABLE = "phases"
"""Name of the longest table."""

_BASELINES = {TRUTH: "true state", CONSTANT: "constant"}


def all_tables(findings: Findings) -> list[Table]:
    """Every table that has rows."""
    tables = [ranking(findings), phases(findings), agreements(findings)]
    return [table for table in tables if table.rows]


def ranking(findings: Findings) -> Table:
    """Combinations by score, then the baselines."""
    rows = []
    for name in (*findings.ranked, *_BASELINES):
        score, place = findings.scores[name], findings.places.get(name)
        rows.append(
            (
                "" if place is None else _range(place),
                _BASELINES.get(name, label(name)),
                f"{score.value:.3f}",
                _interval(score, "{:.3f}"),
                *(_millimetres(findings.error(name, p, NEEDED[p])) for p in PHASES),
                *(f"{one:.3f}" for one in findings.by_seed[name]),
            )
        )
    head = ("place", "cameras", "score", "95 %", *(f"{p}, mm" for p in PHASES))
    head += tuple(f"seed {seed}" for seed in range(findings.seeds))
    note = (
        "Score: mean over phases of 1 - error / error of a constant. Combinations whose intervals"
        " (over held-out episodes) overlap share a place."
    )
    return Table("ranking", "Cameras by what can be read off their images", head, tuple(rows), note)


def phases(findings: Findings) -> Table:
    """Every error of every combination, phase by phase."""
    rows = [
        (
            _BASELINES.get(name, label(name)),
            phase,
            quantity,
            f"{found.value:.3f}",
            _interval(found, "{:.3f}"),
            "yes" if NEEDED[phase] == quantity else "",
        )
        for name in (*findings.ranked, *_BASELINES)
        for phase in PHASES
        for quantity in QUANTITIES
        for found in (findings.error(name, phase, quantity),)
    ]
    head = ("cameras", "phase", "quantity", "error", "95 %", "needed")
    note = "Errors in mm; of grasped, the share of frames in which it is wrong."
    return Table(PHASES_TABLE, "Errors by phase", head, tuple(rows), note)


def agreements(findings: Findings) -> Table:
    """The probe against the paper's measurements and its VLM, and against itself."""
    measured, published = paper.measured(), paper.lists()
    rows = [
        _row(LISTS[name], "the paper's measured", {one: measured[one] for one in members}, findings)
        for name, members in published.items()
    ]
    rows.append(_row("all", "the paper's measured", measured, findings))
    said = zip(paper.answers().rankings, published, strict=True)
    for ranking, name in said:
        predicted = {cameras: -place for cameras, place in ranking.places.items()}
        rows.append(_row(LISTS[name], "the paper's VLM", predicted, findings))
    for one, two in combinations(range(findings.seeds), 2):
        sides = [{name: findings.by_seed[name][s] for name in findings.ranked} for s in (one, two)]
        if len(findings.ranked) > 1:
            rows.append((f"seed {one}", f"seed {two}", *_said(*sides)))
    head = ("list", "against", "n", "tau-b", "p", "rho", "best hit", "worst hit", "regret")
    note = (
        "The probe's order predicts the other one. p by permutation, two-sided; regret: by how much"
        " the probe's first choice falls short of the best there, in that side's unit."
    )
    kept = tuple(row for row in rows if row)
    return Table("agreement", "Agreement of the probe with other rankings", head, kept, note)


def _row(
    name: str, against: str, measured: Mapping[str, float], findings: Findings
) -> tuple[str, ...]:
    """Nothing where the probe has not seen all of the list."""
    if not set(measured) <= set(findings.ranked):
        return ()
    scores = {cameras: findings.scores[cameras].value for cameras in measured}
    return (name, against, *_said(scores, measured))


def _said(predicted: Mapping[str, float], measured: Mapping[str, float]) -> tuple[str, ...]:
    found = agreement(predicted, measured)
    numbers = (found.tau, found.tau_p, found.rho)
    return (
        str(found.n),
        *("" if math.isnan(value) else f"{value:.2f}" for value in numbers),
        "yes" if found.top_hit else "no",
        "yes" if found.bottom_hit else "no",
        f"{found.regret:.2f}",
    )


def _range(place: tuple[int, int]) -> str:
    best, worst = place
    return str(best) if best == worst else f"{best} to {worst}"


def _interval(found: Estimate, form: str) -> str:
    return f"{form.format(found.low)} to {form.format(found.high)}"


def _millimetres(found: Estimate) -> str:
    return f"{found.value:.2f} ({found.low:.2f} to {found.high:.2f})"
