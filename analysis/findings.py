"""Puts what the runs in results/ say into the documentation: ``python -m analysis.findings``.

It refills the tables of docs/evidence.md, writes those of ``analysis.seeds`` into results/, and
draws the figures of docs/findings.md. A table of the page stands below a comment that names it;
everything else is written by hand, and read again after each refill.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from analysis import placements
from analysis.comparisons import TRAITS, claims, difference, effects, writers
from analysis.protocol import (
    BLIND,
    RULE,
    foretold_figure,
    foretold_table,
    held,
    means,
    predicted,
    runs_of,
    sets_figure,
    sets_table,
    traits_table,
)
from analysis.seeds import apart, luck
from needlehoop.study.data import paper
from needlehoop.study.render.style import save, styled
from needlehoop.study.render.table import Cell, Column, Estimated, Table
from needlehoop.study.report.tables import rewards
from needlehoop.study.stats.findings import StudyFindings, study_findings
from needlehoop.study.stats.predictions import MEASURED, PAPERS_MEASURED, scored
from needlehoop.study.stats.run import (
    CHEAT,
    HUMAN_POINTS,
    RETURN,
    SUCCESS,
    SUCCESS_OVER_TRAINING,
    TRAINING,
    Measure,
)

ROOT = Path(__file__).parents[1]

STUDIES = ("fast", "table2", "rewards")

IMITATED = "imitation"
"""The protocol's runs, where their success predicts what earlier studies measured."""

_PROTOCOLS = {"0.5 M": "fast", "1.5 M": "table2"}
"""Studies that stand beside each other on the pages, by how many steps their agents train."""

_MEASURED = {
    f"{steps}{said}": (study, truth)
    for steps, study in _PROTOCOLS.items()
    for truth, said in ((MEASURED, ""), (TRAINING.name, ", over training"))
} | {"the paper's": ("table2", PAPERS_MEASURED)}
"""What predictions are held against: a column's name, the study, and what of it was measured."""

_OVER_TRAINING = {RETURN: "return", TRAINING: "over training"}
"""What the pages call the returns that they compare."""

_REWARDED = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")
"""Camera sets that were trained with every reward."""

_BY_SET = (
    "success, %", "success at best, %", "human's points", "cheat, %", "success over training, %",
    "M steps to 90 %",
)  # fmt: skip
"""What the page says of each of them, one after the other."""


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


def _lines(table: Table) -> list[str]:
    head, *rows = (f"| {' | '.join(row)} |" for row in (table.header, *table.texts))
    return [head, "|" + "---|" * len(table.columns), *rows]


@cache
def study(name: str) -> StudyFindings:
    """What the runs of a study of results/ say."""
    return study_findings(ROOT / "results" / name)


@cache
def protocol() -> pd.DataFrame:
    """The runs of docs/protocol.md's first question."""
    found = study("protocol").study
    assert found is not None
    return runs_of(found)


@cache
def places() -> pd.DataFrame:
    """The runs of its third question: single cameras at random places."""
    found = study("placements").study
    assert found is not None
    return runs_of(found)


def _results() -> Table:
    """The fast protocol's camera sets, the best first, with what else was measured of them.

    That is the paper's protocol as far as it has been run, and the paper's own returns. Success is
    given seed by seed: two seeds of one set can be far apart.
    """
    longer, theirs = {one.cameras: one for one in study("table2").ranked}, paper.measured()
    rows = []
    for one in study("fast").ranked:
        end = longer.get(one.cameras)
        rows.append(
            (
                one.cameras,
                one.success and one.success.value,
                [final.success for final in one.finals],
                one.value.value,
                one.middle(TRAINING),
                one.cheat and one.cheat.value,
                end and end.success and end.success.value,
                end and end.value.value,
                end and end.middle(TRAINING),
                theirs.get(one.cameras),
            )
        )
    columns = (
        Column.share("threaded"), Column("by seed", form=".0f", scale=100.0),
        Column("return", form=".2f"), Column("over training", form=".2f"), Column.share("cheat"),
        Column.share("1.5 M: threaded"), Column("1.5 M: return", form=".2f"),
        Column("1.5 M: over training", form=".2f"),
        Column("the paper's return", form=".2f"),
    )  # fmt: skip
    return Table("results", "", (Column("cameras"), *columns), tuple(rows))


def _picked(
    columns: Sequence[Column], rows: Sequence[Mapping[str, Cell]], names: Sequence[str]
) -> Table:
    """Some of a table's columns, in the order of their names."""
    by_heading = {column.heading: column for column in columns}
    cells = tuple(tuple(row[name] for name in names) for row in rows)
    return Table("", "", tuple(by_heading[name] for name in names), cells)


def _effects() -> Table:
    found = _beside(effects)
    rows = tuple((trait, *(own.get(trait) for own in found)) for trait in TRAITS)
    return Table("effects", "", (Column("trait"), *_protocol_columns()), rows)


def _claims() -> Table:
    found = _beside(claims)
    rows = tuple(
        (claim.text, "{:.2f} / {:.2f}".format(*claim.published), *(own.get(claim) for own in found))
        for claim in found[0]
    )
    columns = (Column("the paper says"), Column("its returns"), *_protocol_columns())
    return Table("claims", "", columns, rows)


def _beside(
    of: Callable[[StudyFindings, Measure], dict[Any, Estimated]],
) -> list[dict[Any, Estimated]]:
    """A comparison by each protocol and kind of return, one after the other."""
    return [of(study(name), measure) for name in _PROTOCOLS.values() for measure in _OVER_TRAINING]


def _protocol_columns() -> list[Column]:
    return [
        Column(f"{steps}: {said} (95 %)", form="+.2f")
        for steps in _PROTOCOLS
        for said in _OVER_TRAINING.values()
    ]


def _foretold() -> Table:
    """Each prediction against the earlier studies: tau-b, p beyond the rule, regret.

    The protocol's runs predict them, too.
    """
    found: dict[str, dict[str, Cell]] = {}
    imitated = scored(IMITATED, means(protocol()), paper.lists().values())
    for column, (name, truth) in _MEASURED.items():
        measured = study(name).truths[truth]
        foretold = [*study(name).predictions_of(truth), imitated]
        for who, lists in predicted(foretold).items():
            tau, p, lost = held(who, lists, measured)
            cell: list[Cell] = [] if tau is None else [tau]
            cell += [] if p is None else [f"p {Column('p', form='p').text(p)}"]
            cell += [f"loses {lost:.2f}"]
            found.setdefault(who, {})[column] = cell
    ordered = [who for who in found if who not in (RULE, BLIND)] + [RULE, BLIND]
    rows = tuple((who, *(found[who].get(column) for column in _MEASURED)) for who in ordered)
    columns = (Column(name, form=".2f") for name in _MEASURED)
    return Table("foretold", "", (Column("prediction"), *columns), rows)


def _rewards() -> Table:
    """Each reward's runs, in the order of ``_REWARDED``, by what compares across rewards."""
    table = rewards(study("rewards"))
    found = {(row["cameras"], row["reward"]): row for row in table.records()}
    rows = [
        {"reward": name}
        | {column: [found[one, name][column] for one in _REWARDED] for column in _BY_SET}
        for name in dict.fromkeys(reward for _, reward in found)
    ]
    return _picked(table.columns, rows, ("reward", *_BY_SET))


def _writers() -> Table:
    measures = (HUMAN_POINTS, SUCCESS, SUCCESS_OVER_TRAINING, CHEAT)
    rows = tuple(
        (name, *(difference(pairs, measure) for measure in measures), len(pairs))
        for name, pairs in writers(study("rewards")).items()
    )
    columns = (
        Column(f"{one.heading} (95 %)", form=f"+.{one.digits}f", scale=Column.of(one).scale)
        for one in measures
    )
    return Table("writers", "", (Column("reward"), *columns, Column("pairs")), rows)


TABLES: Mapping[str, Mapping[str, Callable[[], Table]]] = {
    "evidence.md": {
        "results": _results,
        "effects": _effects,
        "claims": _claims,
        "foretold": _foretold,
        "rewards": _rewards,
        "writers": _writers,
        "protocol": lambda: sets_table(protocol()),
        "protocol_traits": lambda: traits_table(protocol()),
        "places": lambda: placements.places_table(places()),
        "placements": lambda: placements.foretold_table(placements.scores(), places()),
        "protocol_foretold": lambda: foretold_table(
            study("protocol").predictions, means(protocol())
        ),
    },
}
"""The documentation's pages, by the names of their files, and the tables of each."""


FIGURES: Mapping[str, Callable[[], Figure]] = {
    "which_cameras": lambda: sets_figure(protocol()),
    "foretold": lambda: foretold_figure(study("protocol").predictions, means(protocol())),
    "where_cameras": lambda: placements.map_figure(places()),
}
"""PNG files of docs/."""


def main() -> None:
    """Refill pages, write tables, draw figures."""
    for name in STUDIES:
        for table in (luck(study(name)), apart(study(name))):
            table.write(ROOT / "results" / name / "tables")
    for name in TABLES:
        path = ROOT / "docs" / name
        path.write_text(refilled(name, path.read_text()))
    for name, figure in FIGURES.items():
        with styled():
            _, vector = save(figure(), ROOT / "docs" / name)
        vector.unlink()
    print(f"refilled {', '.join(TABLES)}")


if __name__ == "__main__":
    main()
