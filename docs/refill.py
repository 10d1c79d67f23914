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

from needlehoop.study import paper
from needlehoop.study.agreement import pooled
from needlehoop.study.combinations import label
from needlehoop.study.findings import Findings, study_findings
from needlehoop.study.measures import TRAINING, by_seed
from needlehoop.study.predictions import scored
from needlehoop.study.rankings import MEASURED, MEASURED_SOON, PAPERS_MEASURED, repeats
from needlehoop.study.table import Table
from needlehoop.study.tables import all_tables

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "findings.md"

_CLAIMS = (
    "the paper says",
    "its returns",
    "difference, 95 %",
    "return over training: difference, 95 %",
)
"""Columns of which the page has room."""

_LAST = 2
"""The seed that was trained after returns over training had been chosen to judge by."""


def refilled(page: str) -> str:
    """The page with the tables of today's runs."""
    for marker, table in (
        ("results", _ranking()),
        ("results/fast effects", _columns("fast", "effects")),
        ("results/fast claims", _columns("fast", "claims", _CLAIMS)),
        ("results/fast agreement", _agreement()),
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
    head += ("imitated, %", "1.5 M: threaded, %", "1.5 M: return", "the paper's return")
    table: list[Sequence[str]] = [head]
    for row in _rows("fast", "results"):
        cameras = row["cameras"]
        numbers = (row["success, %"], seeds[cameras], row["return"], row[TRAINING.name])
        numbers += (row["cheat, %"], imitated[cameras])
        end = longer.get(cameras, {})
        numbers += (end.get("success, %", ""), end.get("return", ""), theirs.get(cameras, ""))
        table.append((cameras, *numbers))
    return table


def _agreement() -> list[Sequence[str]]:
    """How far each prediction fits the fast protocol, over all lists, and what it took."""
    minutes = {
        row["prediction"]: row["core-minutes"]
        for row in _rows("fast", "cost")
        if row["against"] == MEASURED
    }
    fits: dict[str, dict[str, list[str]]] = {MEASURED: {}, MEASURED_SOON: {}}
    for what, members, *numbers in _tables("fast")["agreement"].rows:
        who, _, against = what.partition(" against ")
        measure = {repeats(one): one for one in fits}.get(against, against)
        if measure in fits and members == "all lists":
            tau, over_seeds, p, *_, regret, regrets = numbers
            cells = [_with(tau, over_seeds), p, _with(regret, regrets)]
            fits[measure][who] = cells
    head = ("prediction", "tau-b", "p", "regret", "over training: tau-b", "p", "regret")
    table: list[Sequence[str]] = [(*head, f"seed {_LAST} alone: tau-b", "core-minutes")]
    alone = _against_the_last()
    for who, cells in fits[MEASURED].items():
        last = (alone.get(who, ""), minutes.get(who, ""))
        table.append((who, *cells, *fits[MEASURED_SOON][who], *last))
    return table


def _against_the_last() -> dict[str, str]:
    """Tau-b of each prediction with returns over training of the last seed, over all lists."""
    found = _findings("fast")
    ends = {cams: own[_LAST] for cams, own in by_seed(found, TRAINING).items() if _LAST in own}
    theirs = scored(PAPERS_MEASURED, paper.measured(), paper.lists().values())
    said = {}
    for one in (*found.predictions, theirs):
        lists = [own for own in one.lists.values() if set(own) <= set(ends)]
        both = [(own, {name: ends[name] for name in own}) for own in lists]
        said[one.who] = f"{pooled(both).tau:.2f}" if both else ""
    return said


def _with(value: str, interval: str) -> str:
    return f"{value} ({interval})" if interval else value


def _columns(study: str, name: str, keep: Sequence[str] = ()) -> list[Sequence[str]]:
    """A table, or some of its columns."""
    table = _tables(study)[name]
    kept = [i for i, column in enumerate(table.header) if not keep or column in keep]
    return [[row[i] for i in kept] for row in (table.header, *table.rows)]


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
