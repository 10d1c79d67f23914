"""Puts what the runs in results/ say into tables of the documentation: ``make findings``.

docs/findings.md has what matters most, docs/evidence.md the whole.

A table stands below a comment that names it; what is between them and around them is written by
hand, and read again after each refill.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from needlehoop.study.data import paper
from needlehoop.study.data.combinations import label
from needlehoop.study.data.findings import Findings, study_findings
from needlehoop.study.report.rankings import MEASURED, MEASURED_SOON, PAPERS_MEASURED, repeats
from needlehoop.study.report.table import Table
from needlehoop.study.report.tables import all_tables
from needlehoop.study.stats.measures import TRAINING

ROOT = Path(__file__).parents[1]

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

_REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")
"""Sets of cameras that were trained with every reward."""

_BY_SET = (
    "success, %", "success at best, %", "human's points", "cheat, %", "threaded over training, %",
    "M steps to 90 %",
)  # fmt: skip
"""What the page says of each of them, one after the other."""

_BLIND = "drawn blindly"

_Table = list[Sequence[str]]
"""Rows of cells, the head first."""


class _Fit(NamedTuple):
    """A prediction held against a measurement, over all lists, as the tables write it."""

    tau: str
    tau_range: str
    p: str
    regret: str
    regret_range: str


def refilled(name: str, page: str) -> str:
    """The page of that name with the tables of today's runs.

    Raises:
        ValueError: a table of the page has no place in it.
    """
    for marker, table in TABLES[name].items():
        head = f"<!-- {marker} -->\n"
        before, found, after = page.partition(head)
        if not found:
            raise ValueError(f"{name}: no table {marker}")
        _, end, after = after.partition("\n\n")
        page = before + head + "\n".join(_lines(table())) + end + after
    return page


def _sets() -> _Table:
    """Of ``_ranking`` what the page of findings has room for, the soonest learnt first."""
    names = ["cameras", "threaded, %", "by seed", "over training", "imitated, %"]
    names += ["1.5 M: threaded, %", "1.5 M: over training", "the paper's return"]
    head, *rows = _picked(_ranking(), names)
    return [head, *sorted(rows, key=lambda row: -float(row[names.index("over training")]))]


def _foretold() -> _Table:
    """How each prediction agrees with how soon and how far ours come, and what it loses."""
    agreement = _picked(
        _agreement(), ("prediction", "0.5 M, over training", "1.5 M", "the paper's")
    )
    regret = _picked(
        _regret(), ("chosen by", "core-minutes", "1.5 M", "1.5 M, over training", "the paper's")
    )
    found = {row[0]: row[1:] for row in agreement[1:]}
    head = (*agreement[0], *(f"regret: {name}" for name in regret[0][2:]), regret[0][1])
    rows = [(who, *found.get(who, ("",) * 3), *lost, minutes) for who, minutes, *lost in regret[1:]]
    return [head, *rows]


def _rewards() -> _Table:
    """Each reward's runs, in the order of ``_REWARDED``, by what compares across rewards."""
    found = {(row["cameras"], row["reward"]): row for row in _rows("rewards", "rewards")}
    table: _Table = [("reward", *_BY_SET)]
    for name in dict.fromkeys(reward for _, reward in found):
        runs = [found[label(cameras), name] for cameras in _REWARDED]
        table.append((name, *(", ".join(row[column] for row in runs) for column in _BY_SET)))
    return table


def _writers() -> _Table:
    names = [name for name in _tables("rewards")["writers"].header if name != "cameras"]
    rows = _rows("rewards", "writers")
    head = [name.replace(": difference", "") for name in names]
    return [head, *([row[name] for name in names] for row in rows)]


def _picked(table: _Table, names: Sequence[str]) -> _Table:
    """Some of a table's columns, in their order."""
    at = [table[0].index(name) for name in names]
    return [[row[i] for i in at] for row in table]


def _ranking() -> _Table:
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
    table: _Table = [head]
    for row in _rows("fast", "results"):
        cameras = row["cameras"]
        numbers = (row["success, %"], seeds[cameras], row["return"], row[TRAINING.name])
        numbers += (row["cheat, %"], imitated[cameras])
        end = longer.get(cameras, {})
        numbers += tuple(end.get(name, "") for name in ("success, %", "return", TRAINING.name))
        table.append((cameras, *numbers, theirs.get(cameras, "")))
    return table


def _effects() -> _Table:
    return _beside("effects", ("trait",), _EFFECTS)


def _claims() -> _Table:
    return _beside("claims", ("the paper says", "its returns"), _CLAIMS)


def _beside(name: str, common: Sequence[str], own: Sequence[str]) -> _Table:
    """A table of each protocol beside the other: what they have in common, then their columns.

    Rows are the first protocol's; the other's are found by the first column.
    """
    studies = [{row[common[0]]: row for row in _rows(study, name)} for study in _PROTOCOLS]
    heads = [f"{steps}: {column}" for steps in _PROTOCOLS.values() for column in _NAMES]
    table: _Table = [(*common, *heads)]
    for key, row in studies[0].items():
        told = [found.get(key, {}).get(column, "") for found in studies for column in own]
        table.append((*(row[column] for column in common), *told))
    return table


def _agreement() -> _Table:
    """Tau-b of each prediction with each measurement."""
    table: _Table = [("prediction", *_MEASURED)]
    for who, fits in _fits().items():
        cells = [
            _with(one.tau, one.tau_range) + (f", p {one.p}" if one.p else "") if one else ""
            for one in (fits.get(column) for column in _MEASURED)
        ]
        table.append((who, *cells))
    return table


def _regret() -> _Table:
    """What choosing by each prediction loses, mean over the lists, and what the choice took."""
    costs = {study: _rows(study, "cost") for study in _PROTOCOLS}
    minutes = {row["prediction"]: row["core-minutes"] for own in costs.values() for row in own}
    blind = {
        (study, row["against"]): row["chosen blindly"]
        for study, own in costs.items()
        for row in own
    }
    table: _Table = [("chosen by", "core-minutes", *_MEASURED)]
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


def _lines(table: _Table) -> list[str]:
    head, *rows = (f"| {' | '.join(row)} |" for row in table)
    return [head, "|" + "---|" * len(table[0]), *rows]


TABLES: Mapping[str, Mapping[str, Callable[[], _Table]]] = {
    "findings.md": {"sets": _sets, "foretold": _foretold, "rewards": _rewards},
    "evidence.md": {
        "results": _ranking,
        "effects": _effects,
        "claims": _claims,
        "agreement": _agreement,
        "regret": _regret,
        "writers": _writers,
    },
}
"""The documentation's pages, by the names of their files, and the tables of each."""

if __name__ == "__main__":
    for name in TABLES:
        path = ROOT / "docs" / name
        path.write_text(refilled(name, path.read_text()))
