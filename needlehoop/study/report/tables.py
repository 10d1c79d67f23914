"""A study's tables: results, the paper's Tables I and II, rewards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.study.data import paper
from needlehoop.study.data.answers import Answers, Ranking
from needlehoop.study.data.combinations import LISTS, label, reward_label, reward_order
from needlehoop.study.data.final import Final
from needlehoop.study.data.findings import Findings, Result
from needlehoop.study.data.predictions import recorded_answers
from needlehoop.study.render.curves import BUFFERS, steps_to_share
from needlehoop.study.report.phases import phases
from needlehoop.study.report.rankings import agreements, measured, rankings
from needlehoop.study.report.table import Table
from needlehoop.study.stats.claims import claims
from needlehoop.study.stats.costs import costs
from needlehoop.study.stats.effects import effects
from needlehoop.study.stats.luck import apart, luck
from needlehoop.study.stats.measures import BEST, THREADING, TRAINING, Measure, middle, values
from needlehoop.study.stats.statistics import (
    ENOUGH,
    OVER_EPISODES,
    Estimate,
    estimate,
    improvement,
    iqm,
    no_interval,
)
from needlehoop.study.stats.writers import writers

_PAPERS = "the paper's"

_SOON = 0.9
"""Success in training from which on a reward has taught the task."""


def all_tables(findings: Findings) -> list[Table]:
    """Every table that has rows."""
    return [table for table in _every(findings) if table.rows]


def write_tables(findings: Findings, folder: Path) -> list[Path]:
    """Write every table that has rows, as CSV, Markdown and LaTeX.

    Args:
        findings: of a study, or of the paper.
        folder: for the files; made where missing. Older tables there are replaced, or removed
            where they have no rows any more.
    """
    return [path for table in _every(findings) for path in table.write(folder)]


def _every(findings: Findings) -> list[Table]:
    return [
        results(findings),
        phases(findings),
        rewards(findings),
        writers(findings),
        apart(findings),
        luck(findings),
        effects(findings),
        claims(findings),
        table_1(findings),
        table_2(findings),
        rankings(findings),
        agreements(findings),
        costs(findings),
        improvements(findings),
    ]


def results(findings: Findings) -> Table:
    """Every combination with every reward: reward by reward, the best return first."""
    rows = []
    places: Counter[str] = Counter()
    for result in sorted(findings.results, key=lambda one: reward_order(one.reward)):
        places[result.reward] += 1
        rows.append(
            (
                str(places[result.reward]),
                label(result.cameras),
                f"{result.value.value:.2f}",
                result.value.interval,
                _told(result, TRAINING),
                _percent(result.success),
                _interval(result.success),
                _percent(result.cheat),
                reward_label(result.reward),
                str(result.value.seeds),
                str(result.unfinished),
            )
        )
    head = ("place", "cameras", "return", "return, 95 %", TRAINING.name, "success, %")
    head += ("success, 95 %", "cheat, %", "reward")
    note = (
        f"{TRAINING.name.capitalize()}: the mean of all training episodes, by steps, of runs whose"
        " training is over. Interquartile means over seeds. Intervals are bootstrapped over three"
        " seeds or more; with fewer, Wilson's over all episodes, for rates alone."
    )
    if any(result.reward != findings.main_reward for result in findings.results):
        note += (
            " A return is in its own reward's points, and its place is among those of the same"
            " reward: across rewards, compare success."
        )
    if findings.study is None:
        note = "As the paper reports them: one run each, returns only."
    return Table("results", "Results", (*head, "seeds", "unfinished"), tuple(rows), note)


def table_1(findings: Findings) -> Table:
    """What the VLM answered, beside the shipped recordings' models and the paper's."""
    shown = [*recorded_answers(), Answers(f"{_PAPERS} VLM", paper.answers().questions)]
    if findings.study is not None and findings.answers and findings.answers.questions:
        shown.insert(0, findings.answers)
    said = [{answer.question: answer.answer for answer in one.questions} for one in shown]
    asked = said[-1] if findings.study is None else {q: None for one in said for q in one}
    rows = tuple((question, *(one.get(question, "") for one in said)) for question in asked)
    head = ("question", *(one.source for one in shown))
    return Table("table_1", "Table I: what the VLM answered", head, rows)


def table_2(findings: Findings) -> Table:
    """Measured and predicted places in each list, ours and the paper's."""
    ours, published = measured(findings), paper.measured()
    said = _predicted(findings.answers) if findings.study is not None else {}
    papers = _predicted(paper.answers())
    rows = []
    for name, members in findings.lists.items():
        own, theirs = _places(ours, members), _places(published, members)
        ordered = sorted(
            members, key=lambda cameras: (own.get(cameras, 99), theirs.get(cameras, 99))
        )
        for cameras in ordered:
            result = _result(findings, cameras)
            rows.append(
                (
                    LISTS.get(name, name),
                    label(cameras),
                    _place(own.get(cameras), len(own) if len(own) < len(members) else None),
                    f"{result.value.value:.2f}" if result else "",
                    result.value.interval if result else "not run",
                    _percent(result.success) if result else "",
                    _place(_mean_place(said, members, cameras)),
                    _place(theirs.get(cameras)),
                    f"{published[cameras]:.2f}" if cameras in published else "",
                    _place(_mean_place(papers, members, cameras)),
                    _better(theirs.get(cameras), _mean_place(papers, members, cameras)),
                )
            )
    head = ("list", "cameras", "place", "return", "95 %", "success, %", "VLM's place")
    head += (f"{_PAPERS} place", f"{_PAPERS} return", f"{_PAPERS} VLM's place")
    head += ("better there than its VLM said",)
    title = "Table II: measured and predicted"
    if findings.study is None:
        # Its own numbers are in the columns that say so.
        keep = (0, 1, 7, 8, 9, 10)
        head = tuple(head[i] for i in keep)
        rows = [tuple(row[i] for i in keep) for row in rows]
        title = "Table II, as published in the paper"
    return Table("table_2", title, head, tuple(rows))


def rewards(findings: Findings) -> Table:
    """Combinations that were trained with a VLM's reward, beside the human one."""
    published = {(r.cameras, r.reward): r for r in paper.rewards()}
    written = {r.cameras for r in findings.results if r.reward != findings.main_reward}
    rows = []
    chosen = [r for r in findings.ranked if r.cameras in written]
    for best in chosen:
        rivals = [r for r in findings.results if r.cameras == best.cameras]
        for result in sorted(rivals, key=lambda r: reward_order(r.reward)):
            theirs = published.get((result.cameras, result.reward))
            rows.append(
                (
                    label(result.cameras),
                    reward_label(result.reward),
                    f"{result.value.value:.2f}",
                    result.value.interval,
                    _human(result.finals),
                    _percent(result.success),
                    _interval(result.success),
                    _told(result, BEST),
                    _percent(result.cheat),
                    _told(result, THREADING),
                    _times(result),
                    f"{theirs.value:.2f}" if theirs and theirs.value else "not published",
                    theirs.remark if theirs else "",
                )
            )
    for reward in sorted({r.reward for r in findings.results}, key=reward_order):
        own = [r for r in findings.results if r.reward == reward and r.cameras in written]
        if len(chosen) > 1 and len(own) == len(chosen) and all(r.finals for r in own):
            rows.append(_over_all(reward, own))
    head = ("cameras", "reward", "return", "return, 95 %", "human's points", "success, %")
    head += ("success, 95 %", BEST.name, "cheat, %", THREADING.name)
    head += (f"M steps to {100 * _SOON:.0f} %",)
    head += (f"{_PAPERS} return", "remark on the paper's")
    note = (
        "A return is in its own reward's points: compare success, or the points that the human"
        f" reward gives the same episodes. {BEST.name.capitalize()}: of the evaluations on the way,"
        " of fewer episodes each; what the last has less was learnt and lost again."
        f" {THREADING.name.capitalize()}: of all training episodes."
        f" M steps: millions, until {100 * _SOON:.0f} % of the"
        f" training episodes succeed, over {BUFFERS} buffers; a number for each seed."
    )
    return Table("rewards", "Rewards: human, text, text + image", head, tuple(rows), note)


def _over_all(reward: str, found: list[Result]) -> tuple[str, ...]:
    """A reward's row over several combinations, each of them a stratum."""
    value = estimate([[final.value for final in r.finals] for r in found])
    success = estimate([[final.success for final in r.finals] for r in found])
    cheat = estimate([[final.cheat for final in r.finals] for r in found])
    return (
        f"all {len(found)}",
        reward_label(reward),
        f"{value.value:.2f}",
        value.interval,
        _human([final for r in found for final in r.finals]),
        _percent(success),
        _interval(success),
        _over(found, BEST),
        _percent(cheat),
        _over(found, THREADING),
        "",
        "",
        "",
    )


def _over(found: Sequence[Result], measure: Measure) -> str:
    """The interquartile mean of all runs; empty where one of them has no such number."""
    own = [values(result, measure) for result in found]
    return f"{iqm(np.concatenate(own)):.{measure.digits}f}" if all(own) else ""


def _told(result: Result, measure: Measure) -> str:
    found = middle(result, measure)
    return "" if found is None else f"{found:.{measure.digits}f}"


def _times(result: Result) -> str:
    """Millions of steps until each run, by its seed, threads in ``_SOON`` of its episodes."""
    steps = [steps_to_share(run, "success", _SOON) for run in result.runs]
    return ", ".join("not reached" if one is None else f"{one / 1e6:.2f}" for one in steps)


def _human(finals: Sequence[Final]) -> str:
    """The mean of the runs' points under the human reward; empty where one has none.

    Points of another scene unit than today's default are told by it.
    """
    points = [final.human for final in finals if final.human is not None]
    if not points or len(points) < len(finals):
        return ""
    now = read_yaml(CONF / "reward/human.yaml")["unit"]
    units = {final.human_unit for final in finals} - {None, now}
    others = " and ".join(f"{unit:g}" for unit in sorted(filter(None, units)))
    return f"{sum(points) / len(points):.2f}" + (f" (unit {others} m)" if others else "")


def improvements(findings: Findings) -> Table:
    """The chance that a run of the row's combination beats one of the column's."""
    found = findings.ranked
    if findings.seeds < ENOUGH or len(found) < 2:
        none = no_interval(findings.seeds)
        return Table("improvement", "Probability of improvement", (), (), none)
    values = [[final.value for final in result.finals] for result in found]
    rows = []
    for i, row in enumerate(found):
        cells = ["" if i == j else f"{_chance(values[i], values[j])}" for j in range(len(found))]
        rows.append((label(row.cameras), *cells))
    head = ("better", *(label(result.cameras) for result in found))
    note = "By final return, with 95 % bootstrap intervals."
    return Table("improvement", "Probability of improvement", head, tuple(rows), note)


def _chance(better: list[float], worse: list[float]) -> str:
    found = improvement(better, worse)
    return f"{found.value:.2f} ({found.low:.2f} to {found.high:.2f})"


def _result(findings: Findings, cameras: str) -> Result | None:
    return next((result for result in findings.ranked if result.cameras == cameras), None)


def _predicted(answers: Answers | None) -> dict[frozenset[str], dict[str, float]]:
    """Scores (higher is better) of each ranked list, by its members."""
    rankings: tuple[Ranking, ...] = answers.rankings if answers else ()
    return {
        frozenset(ranking.places): {name: -place for name, place in ranking.places.items()}
        for ranking in rankings
    }


def _places(values: Mapping[str, float], members: tuple[str, ...]) -> dict[str, float]:
    """Places of those members that have a value: 1 is the highest; ties share the best place."""
    known = {cameras: values[cameras] for cameras in members if cameras in values}
    return {
        cameras: 1.0 + sum(other > value for other in known.values())
        for cameras, value in known.items()
    }


def _mean_place(
    predicted: Mapping[frozenset[str], Mapping[str, float]], members: tuple[str, ...], cameras: str
) -> float | None:
    scores = predicted.get(frozenset(members))
    return None if scores is None else -scores[cameras]


def _place(place: float | None, of: int | None = None) -> str:
    """A place; with ``of``, among so many only."""
    if place is None:
        return ""
    return f"{place:g}" if of is None else f"{place:g} of {of}"


def _better(measured: float | None, predicted: float | None) -> str:
    """``yes`` for a measured place before the predicted one, as the paper marks in red."""
    if measured is None or predicted is None:
        return ""
    return "yes" if measured < predicted else "no"


def _percent(found: Estimate | None) -> str:
    return "" if found is None else f"{100 * found.value:.0f}"


def _interval(found: Estimate | None) -> str:
    if found is None:
        return ""
    if found.low is None or found.high is None:
        return no_interval(found.seeds)
    told = f"{100 * found.low:.0f} to {100 * found.high:.0f}"
    return f"{told} ({OVER_EPISODES})" if found.over == OVER_EPISODES else told
