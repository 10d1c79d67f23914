"""What a probe shows: the ranking as a table and a figure, and its agreement with others."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

from matplotlib.figure import Figure

from needlehoop.probe.scores import CONSTANT, TRUTH, ProbeResults
from needlehoop.study.data import paper
from needlehoop.study.render.style import COLOURS, DASHES, new_figure, save, styled
from needlehoop.study.render.table import Table, written
from needlehoop.study.report.tables import agreed
from needlehoop.study.stats.agreement import agreement
from needlehoop.study.stats.predictions import PAPERS_MEASURED, said

_BASELINES = {TRUTH: "true state", CONSTANT: "constant"}

_NOTE = (
    "Score: mean over phases of 1 - error / error of a constant. Camera sets whose intervals (over"
    " held-out episodes) overlap share a place."
)


def write(results: ProbeResults, folder: Path) -> str:
    """Write ``ranking.csv``, ``.md`` and ``.png``; returns the tables as text."""
    tables = [ranking(results), agreements(results)]
    tables[0].write(folder)
    with styled():
        save(ranking_figure(results), folder / "ranking")
    return "\n\n".join(table.text() for table in tables if not table.rows.empty)


def ranking(results: ProbeResults) -> Table:
    """Camera sets by score, then the baselines; errors are in mm, with 95 % intervals."""
    rows = []
    for name in (*results.ranked, *_BASELINES):
        best, worst = results.places.get(name, ("", ""))
        mean = results.score(name)
        row = {
            "place": f"{best}" if best == worst else f"{best} to {worst}",
            "cameras": _BASELINES.get(name, name),
            "score": written(mean.value, ".3f"),
            "95 %": written(mean.interval, ".3f"),
        }
        for phase, quantity in results.targets.needed.items():
            row[f"{phase}, mm"] = written(results.error(name, phase, quantity))
        for seed, score in enumerate(results.scores_by_seed(name)):
            row[f"seed {seed}"] = f"{score:.3f}"
        rows.append(row)
    return Table.of("ranking", "Cameras by what can be read off their images", rows, _NOTE)


def agreements(results: ProbeResults) -> Table:
    """The probe against the paper's measurements and its VLM, and seed against seed.

    The probe's order predicts the other one. ``regret``: by how much the probe's first choice
    falls short of the best there, in that side's unit.
    """
    scores = {name: results.score(name).value for name in results.ranked}
    sides = []
    if results.targets.task == paper.task():
        measured, lists = paper.measured(), paper.lists()
        for name, members in {**lists, "all": [*measured]}.items():
            sides.append((name, PAPERS_MEASURED, scores, {one: measured[one] for one in members}))
        paper_answers = said(paper.SOURCE, paper.answers())
        sides += [
            (name, paper_answers.source, scores, order)
            for name, order in zip(lists, paper_answers.lists.values(), strict=True)
        ]
    by_seed = {name: results.scores_by_seed(name) for name in scores}
    for pair in combinations(range(results.seeds), 2):
        first, second = ({name: values[seed] for name, values in by_seed.items()} for seed in pair)
        sides.append((f"seed {pair[0]}", f"seed {pair[1]}", first, second))
    rows = []
    for name, against, predicted, truth in sides:
        # Nothing where the probe has not seen all of the list.
        if len(truth) > 1 and truth.keys() <= predicted.keys():
            fit = agreement(({cams: predicted[cams] for cams in truth}, truth))
            row = {"list": name, "against": against, "n": str(len(truth))}
            rows.append(row | agreed(fit))
    return Table.of("agreement", "Agreement of the probe", rows)


def ranking_figure(results: ProbeResults) -> Figure:
    """Scores with intervals, and beside them the errors in each phase."""
    names, rows, needed = results.ranked, range(len(results.ranked)), results.targets.needed
    # 4.2 mm for each camera set.
    figure, [[left, right]] = new_figure(24 + 4.2 * len(names), 1, 2, sharey=True)
    for y, name in enumerate(names):
        score = results.score(name)
        assert score.interval is not None
        ends = [score.interval.low, score.interval.high]
        left.plot(ends, [y, y], color=COLOURS[0], linewidth=1.6)
        left.plot(score.value, y, "o", color=COLOURS[0], markersize=3)
    left.set_yticks(rows, names)
    left.set_ylim(len(names) - 0.4, -0.6)
    left.set_xlabel("score (1: no error)")
    looks = zip(COLOURS[1:], "os^Dv", strict=False)
    for (phase, quantity), (colour, mark) in zip(needed.items(), looks, strict=False):
        values = [results.error(name, phase, quantity).value for name in names]
        right.plot(values, rows, mark, color=colour, markersize=3.2, label=phase)
        floor = results.error(TRUTH, phase, quantity).value
        right.axvline(floor, color=colour, linewidth=0.6, linestyle=DASHES[3])
    right.set_xlim(left=0)
    right.set_xlabel("error, mm\n(dotted: true state)")
    for axes in (left, right):
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="both", linewidth=0.3)
    figure.legend(loc="outside upper right", ncols=3, frameon=False, fontsize=6.5,
                  handletextpad=0.1, columnspacing=0.8)  # fmt: skip
    return figure
