"""Puts what the runs in results/ say into the tables of docs/findings.md: ``make findings``.

A table stands below a comment that names it; what is between them and around them is written by
hand, and read again after each refill.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from needlehoop.study import paper
from needlehoop.study.combinations import label
from needlehoop.study.findings import Findings, study_findings
from needlehoop.study.measures import TRAINING
from needlehoop.study.rankings import MEASURED, MEASURED_SOON, PAPERS_MEASURED, repeats
from needlehoop.study.table import Table
from needlehoop.study.tables import all_tables

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "findings.md"

_PROTOCOLS = {"fast": "0.5 M", "table2": "1.5 M"}
"""Studies that stand beside each other on the page, by how many steps their agents train."""

_MEASURED = {
    f"{steps}{said}": (study, against)
    for study, steps in _PROTOCOLS.items()
    for against, said in ((MEASURED, ""), (MEASURED_SOON, ", over training"))
} | {"the paper's": ("table2", PAPERS_MEASURED)}
"""What predictions are held against: a column's name, and whose table has it under which name."""

_EFFECTS = ("return (95 %)", "return over training (95 %)")
_CLAIMS = ("difference, 95 %", "return over training: difference, 95 %")
"""Columns of which the page has room, of each protocol, and ..."""

_NAMES = ("return (95 %)", "over training (95 %)")
"""... what the page calls them."""

_BLIND = "drawn blindly"


class _Fit(NamedTuple):
    """A prediction held against a measurement, over all lists, as the tables write it."""

    tau: str
    tau_range: str
    p: str
    regret: str
    regret_range: str


def refilled(page: str) -> str:
    """The page with the tables of today's runs."""
    for marker, table in (
        ("results", _ranking()),
        ("effects", _beside("effects", ("trait",), _EFFECTS)),
        ("claims", _beside("claims", ("the paper says", "its returns"), _CLAIMS)),
        ("agreement", _agreement()),
        ("regret", _regret()),
    ):
        head = f"<!-- {marker} -->\n"
        before, found, after = page.partition(head)
        if not found:
            raise ValueError(f"{PAGE}: no table {marker}")
        _, end, after = after.partition("\n\n")
        page = before + head + "\n".join(_lines(table)) + end + after
    return page


def _ranking() -> list[Sequence[str]]:
    """The fast protocol's sets, the best first, with what else was measured of them beside.

    That is imitation's successes, the paper's protocol as far as it has been run, and the paper's
    own returns. Success is given seed by seed: two seeds of one set can be far apart.
    """
    seeds = {
        label(result.cameras): ", ".join(f"{100 * one.success:.0f}" for one in result.finals)
        for result in _findings("fast").ranked
    }
    imitated = {row["cameras"]: row["success, %"] for row in _rows("imitation", "results")}
    longer = {row["cameras"]: row for row in _rows("table2", "results")}
    theirs = {label(cameras): f"{value:.2f}" for cameras, value in paper.measured().items()}
    head = ("cameras", "threaded, %", "by seed", "return", "over training", "cheat, %")
    head += ("imitated, %", "1.5 M: threaded, %", "1.5 M: return", "1.5 M: over training")
    head += ("the paper's return",)
    table: list[Sequence[str]] = [head]
    for row in _rows("fast", "results"):
        cameras = row["cameras"]
        numbers = (row["success, %"], seeds[cameras], row["return"], row[TRAINING.name])
        numbers += (row["cheat, %"], imitated[cameras])
        end = longer.get(cameras, {})
        numbers += tuple(end.get(name, "") for name in ("success, %", "return", TRAINING.name))
        table.append((cameras, *numbers, theirs.get(cameras, "")))
    return table


def _beside(name: str, common: Sequence[str], own: Sequence[str]) -> list[Sequence[str]]:
    """A table of each protocol beside the other: what they have in common, then their columns.

    Rows are the first protocol's; the other's are found by the first column.
    """
    studies = [{row[common[0]]: row for row in _rows(study, name)} for study in _PROTOCOLS]
    heads = [f"{steps}: {column}" for steps in _PROTOCOLS.values() for column in _NAMES]
    table: list[Sequence[str]] = [(*common, *heads)]
    for key, row in studies[0].items():
        told = [found.get(key, {}).get(column, "") for found in studies for column in own]
        table.append((*(row[column] for column in common), *told))
    return table


def _agreement() -> list[Sequence[str]]:
    """Tau-b of each prediction with each measurement."""
    table: list[Sequence[str]] = [("prediction", *_MEASURED)]
    for who, fits in _fits().items():
        cells = [
            _with(one.tau, one.tau_range) + (f", p {one.p}" if one.p else "") if one else ""
            for one in (fits.get(column) for column in _MEASURED)
        ]
        table.append((who, *cells))
    return table


def _regret() -> list[Sequence[str]]:
    """What choosing by each prediction loses, mean over the lists, and what the choice took."""
    costs = {study: _rows(study, "cost") for study in _PROTOCOLS}
    minutes = {row["prediction"]: row["core-minutes"] for own in costs.values() for row in own}
    blind = {
        (study, row["against"]): row["chosen blindly"]
        for study, own in costs.items()
        for row in own
    }
    table: list[Sequence[str]] = [("chosen by", "core-minutes", *_MEASURED)]
    for who, fits in _fits().items():
        found = [fits.get(column) for column in _MEASURED]
        cells = [_with(one.regret, one.regret_range) if one else "" for one in found]
        table.append((who, minutes.get(who, ""), *cells))
    return [*table, (_BLIND, "0", *(blind.get(side, "") for side in _MEASURED.values()))]


@cache
def _fits() -> dict[str, dict[str, _Fit]]:
    """By who predicts, then by the page's column."""
    found: dict[str, dict[str, _Fit]] = {}
    for column, (study, against) in _MEASURED.items():
        for what, members, *numbers in _tables(study)["agreement"].rows:
            who, _, other = what.partition(" against ")
            if members == "all lists" and other in (against, repeats(against)):
                tau, tau_range, p, *_, regret, regret_range = numbers
                found.setdefault(who, {})[column] = _Fit(tau, tau_range, p, regret, regret_range)
    return found


def _with(value: str, interval: str) -> str:
    return f"{value} ({interval})" if interval else value


@cache
def _tables(study: str) -> dict[str, Table]:
    return {one.name: one for one in all_tables(_findings(study))}


@cache
def _findings(study: str) -> Findings:
    return study_findings(ROOT / "results" / study)


def _rows(study: str, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(_tables(study)[name].csv())))


def _lines(table: Sequence[Sequence[str]]) -> list[str]:
    head, *rows = (f"| {' | '.join(row)} |" for row in table)
    return [head, "|" + "---|" * len(table[0]), *rows]


if __name__ == "__main__":
    PAGE.write_text(refilled(PAGE.read_text()))
