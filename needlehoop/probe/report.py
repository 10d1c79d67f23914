"""What a probe shows: the ranking as a table and a figure, and its agreement with others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from needlehoop.probe.frames import Quantities
from needlehoop.probe.scores import CONSTANT, TRUTH, ProbeResults
from needlehoop.study.data import paper
from needlehoop.study.data.paper import LISTS
from needlehoop.study.render.style import COLOURS, DASHES, new_figure, save, styled
from needlehoop.study.stats.agreement import agreement
from needlehoop.study.stats.predictions import PAPERS_MEASURED, said
from needlehoop.study.stats.statistics import Estimated

_BASELINES = {TRUTH: "true state", CONSTANT: "constant"}


def write(results: ProbeResults, folder: Path) -> str:
    """Write ``ranking.csv``, ``.md``, ``.png`` and ``.svg``; returns the tables as text."""
    table = ranking(results)
    table.to_csv(folder / "ranking.csv", index=False)
    text = _markdown(table)
    (folder / "ranking.md").write_text(
        f"**Cameras by what can be read off their images**\n\n{text}\n\n"
        "Score: mean over phases of 1 - error / error of a constant. Camera sets whose intervals"
        " (over held-out episodes) overlap share a place.\n"
    )
    with styled():
        save(ranking_figure(results), folder / "ranking")
    compared = agreements(results)
    return text if compared.empty else f"{text}\n\n{_markdown(compared)}"


def ranking(results: ProbeResults) -> pd.DataFrame:
    """Camera sets by score, then the baselines; errors are in mm, with 95 % intervals."""
    rows = []
    for name in (*results.ranked, *_BASELINES):
        best, worst = results.places.get(name, ("", ""))
        found = results.score(name)
        row = {
            "place": f"{best}" if best == worst else f"{best} to {worst}",
            "cameras": _BASELINES.get(name, name),
            "score": f"{found.value:.3f}",
            "95 %": _ends(found, 3),
        }
        for phase, quantity in results.asked.needed.items():
            error = results.error(name, phase, quantity)
            row[f"{phase}, mm"] = f"{error.value:.2f} ({_ends(error, 2)})"
        for seed, score in enumerate(results.scores_by_seed(name)):
            row[f"seed {seed}"] = f"{score:.3f}"
        rows.append(row)
    return pd.DataFrame(rows)


def _ends(found: Estimated, digits: int) -> str:
    assert found.interval is not None
    return f"{found.interval.low:.{digits}f} to {found.interval.high:.{digits}f}"


def _chance(p: float) -> str:
    return f"{p:.2f}" if p >= 0.01 else f"{p:.1g}"


def _markdown(table: pd.DataFrame) -> str:
    return table.to_markdown(index=False, disable_numparse=True)


def agreements(results: ProbeResults) -> pd.DataFrame:
    """The probe against the paper's measurements and its VLM, and seed against seed.

    The probe's order predicts the other one. ``regret``: by how much the probe's first choice
    falls short of the best there, in that side's unit.
    """
    scores = {name: results.score(name).value for name in results.ranked}
    sides = [
        (name, against, {one: scores[one] for one in theirs}, theirs)
        for name, against, theirs in _published(results.asked)
        # Nothing where the probe has not seen all of the list.
        if set(theirs) <= set(scores)
    ]
    for one, two in combinations(range(results.seeds) if len(scores) > 1 else (), 2):
        own = {name: results.scores_by_seed(name) for name in scores}
        first, second = ({name: own[name][seed] for name in own} for seed in (one, two))
        sides.append((f"seed {one}", f"seed {two}", first, second))
    compared = [(name, against, agreement(own, theirs)) for name, against, own, theirs in sides]
    return pd.DataFrame(
        {
            "list": name,
            "against": against,
            "n": found.n,
            "tau-b": f"{found.tau:.2f}",
            "p of tau-b": _chance(found.tau_p),
            "rho": f"{found.rho:.2f}",
            "p of rho": _chance(found.rho_p),
            "best found": "yes" if found.top_hits else "no",
            "worst found": "yes" if found.bottom_hits else "no",
            "regret": f"{found.regret:.2f}",
        }
        for name, against, found in compared
    )


def _published(asked: Quantities) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """The paper's lists with what it measured, then what its VLM said; of its own task alone."""
    if asked.task != paper.task():
        return
    measured, published = paper.measured(), paper.lists()
    for name, members in published.items():
        yield LISTS[name], PAPERS_MEASURED, {one: measured[one] for one in members}
    yield "all", PAPERS_MEASURED, measured
    told = said(paper.SOURCE, paper.answers())
    for name, scores in zip(published, told.lists.values(), strict=True):
        yield LISTS[name], told.who, scores


def ranking_figure(results: ProbeResults) -> Figure:
    """Scores with intervals, and beside them the errors in each phase."""
    names, rows = results.ranked, range(len(results.ranked))
    # 4.2 mm for each camera set.
    figure, [[left, right]] = new_figure(24 + 4.2 * len(names), 1, 2, sharey=True)
    for y, name in enumerate(names):
        found = results.score(name)
        assert found.interval is not None
        ends = [found.interval.low, found.interval.high]
        left.plot(ends, [y, y], color=COLOURS[0], linewidth=1.6)
        left.plot(found.value, y, "o", color=COLOURS[0], markersize=3)
    left.set_yticks(rows, names)
    left.set_ylim(len(names) - 0.4, -0.6)
    left.set_xlabel("score (1: no error)")
    looks = zip(COLOURS[1:], "os^Dv", strict=False)
    for (phase, quantity), (colour, mark) in zip(results.asked.needed.items(), looks, strict=False):
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
