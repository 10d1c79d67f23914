"""A study's tables: results, where they fail, rewards, the paper's Tables I and II, agreement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from needlehoop.study.data import paper
from needlehoop.study.data.paper import LISTS, reward_label, reward_order
from needlehoop.study.render.table import Cell, Column, Of, Row, Table
from needlehoop.study.stats.agreement import Agreement, agreement, pooled
from needlehoop.study.stats.findings import SEVERITY, Result, StudyFindings, robustness
from needlehoop.study.stats.predictions import MEASURED, recorded_answers
from needlehoop.study.stats.run import (
    BEST,
    BUFFERS,
    CHEAT,
    HUMAN_POINTS,
    RETURN,
    SUCCESS,
    SUCCESS_OVER_TRAINING,
    TRAINING,
    Measure,
    steps_to_share,
)
from needlehoop.study.stats.statistics import ENOUGH, SeedEstimate, improvement

_SOON = 0.9
"""Success in training from which on a reward has taught the task."""

TO_SOON = Column(f"M steps to {100 * _SOON:.0f} %", form=".2f", scale=1e-6)

_FINE = 0.95
"""Success from which on a camera set does not fail."""

_PAST = 0.05
"""Share of episodes that may come to a later phase's end and not to an earlier one's."""

_CAMERAS, _REWARD, _SEEDS, _LIST = map(Column, ("cameras", "reward", "seeds", "list"))
_RETURN = Column.of(RETURN)
_PAPERS_RETURN = replace(_RETURN, name="the paper's return")


def all_tables(findings: StudyFindings) -> list[Table]:
    """Every table that has rows."""
    return [table for table in _every(findings) if table.rows]


def write_tables(findings: StudyFindings, folder: Path) -> list[Path]:
    """Write every table that has rows, as CSV, Markdown and LaTeX.

    Older tables in the folder are replaced, or removed where they have no rows any more.
    """
    return [path for table in _every(findings) for path in table.write(folder)]


def _every(findings: StudyFindings) -> list[Table]:
    makers = (results, stress, phases, rewards, table_1, table_2, agreements, improvements)
    return [maker(findings) for maker in makers]


def _estimated(measure: Measure, found: SeedEstimate | None, missing: str | None = None) -> Row:
    """A value over seeds, and in a column of its own the interval or why there is none."""
    column = Column.of(measure)
    ends = replace(column, name=f"{measure.name}, 95 %", unit="")
    return {column: found and found.value, ends: found.interval_or_why if found else missing}


def results(findings: StudyFindings) -> Table:
    """Every camera set with every reward: reward by reward, the best return first."""
    rows: list[Row] = []
    places: Counter[str] = Counter()
    for result in sorted(findings.results, key=lambda one: reward_order(one.reward)):
        places[result.reward] += 1
        rows.append(
            {
                Column("place"): places[result.reward],
                _CAMERAS: result.cameras,
                **_estimated(RETURN, result.value),
                Column.of(TRAINING): result.middle(TRAINING),
                **_estimated(SUCCESS, result.success),
                Column.of(CHEAT): result.cheat and result.cheat.value,
                _REWARD: reward_label(result.reward),
                _SEEDS: result.value.seeds,
                Column("unfinished"): result.unfinished,
            }
        )
    note = (
        f"{TRAINING.name.capitalize()}: the mean of all training episodes, by steps, of runs whose"
        " training is over. Means over seeds. Intervals are over three seeds or more; with fewer,"
        " Wilson's over all episodes, for rates alone."
    )
    if any(result.reward != findings.main_reward for result in findings.results):
        note += (
            " A return is in its own reward's points, and its place is among those of the same"
            " reward: across rewards, compare success."
        )
    if findings.study is None:
        note = "As the paper reports them: one run each, returns only."
    return Table.of("results", "Results", rows, note)


def stress(findings: StudyFindings) -> Table:
    """What disturbances cost each camera set, the least first."""
    rows: list[Row] = []
    for one in robustness(findings):
        hurts = [f"{axis} {100 * found.value:.0f} %" for axis, found in list(one.axes.items())[:3]]
        rows.append(
            {
                _CAMERAS: one.name,
                Column.share("undisturbed"): one.undisturbed.value,
                Column.share(f"severity {SEVERITY}"): one.mean,
                Column.share("all at once"): one.together and one.together.value,
                Column("hurts most"): ", ".join(hurts),
                Column("axes"): len(one.axes),
                _SEEDS: one.undisturbed.seeds,
            }
        )
    note = (
        "Success of the mean action. Each axis of disturbance by itself, the mean over axes, with a"
        " 95 % interval; then all of them at once. docs/robustness.md says what each axis does."
    )
    return Table.of("stress", "Under disturbances", rows, note)


def fails_in(result: Result) -> str:
    """The phase in which most episodes end; empty where next to none fail, or there are no phases.

    A reward may let episodes go past a phase's end. Then this phase and the next are one.
    """
    phases = _phases(result)
    shares = np.array([_share(result, fact) for _, fact in phases])
    if not phases or shares[-1] >= _FINE:
        return ""
    behind = np.maximum.accumulate(shares[::-1])[::-1]
    first = last = int(np.argmin(np.diff(behind, prepend=1.0)))
    while behind[last] > shares[last] + _PAST:
        last += 1
    return " and ".join(name for name, _ in phases[first : last + 1])


def _share(result: Result, fact: str) -> float:
    """Of final episodes, the mean over seeds."""
    return float(np.mean([found.shares[fact] for found in result.finals]))


def _phases(result: Result) -> tuple[tuple[str, str], ...]:
    """Of the task; none where seeds differ in it, because there is no mean over them."""
    found = {run.task.phases for run in result.runs}
    return found.pop() if len(found) == 1 else ()


def phases(findings: StudyFindings) -> Table:
    """How far each camera set came with each reward, in the order of results."""
    ends = [(one, [fact for _, fact in _phases(one)]) for one in findings.results]
    facts = dict.fromkeys(fact for _, own in ends for fact in own)
    rows: list[Row] = [
        {
            _CAMERAS: result.cameras,
            **{Column.share(fact): _share(result, fact) if fact in own else None for fact in facts},
            Column("fails in"): fails_in(result),
            _REWARD: reward_label(result.reward),
            _SEEDS: result.value.seeds,
        }
        for result, own in ends
        if own
    ]
    note = (
        "Shares of final episodes, means over seeds. Fails in: the phase in which most episodes"
        f" end, where less than {100 * _FINE:.0f} % come to the end of the last."
    )
    return Table.of("phases", "Where they fail", rows, note)


def rewards(findings: StudyFindings) -> Table:
    """Camera sets that were trained with several rewards."""
    written = {r.cameras for r in findings.results if r.reward != findings.main_reward}
    chosen = [r.cameras for r in findings.ranked if r.cameras in written]
    by_reward = sorted(findings.results, key=lambda r: reward_order(r.reward))
    published = paper.rewards()
    rows: list[Row] = []
    for result in (r for cameras in chosen for r in by_reward if r.cameras == cameras):
        row: Row = {
            _CAMERAS: result.cameras,
            _REWARD: reward_label(result.reward),
            **_estimated(RETURN, result.value),
            Column.of(HUMAN_POINTS): result.middle(HUMAN_POINTS),
            **_estimated(SUCCESS, result.success),
            Column.of(BEST): result.middle(BEST),
            Column.of(CHEAT): result.cheat and result.cheat.value,
            Column.of(SUCCESS_OVER_TRAINING): result.middle(SUCCESS_OVER_TRAINING),
            TO_SOON: soon(result),
        }
        if findings.is_papers:
            value, remark = published.get((result.cameras, result.reward), (None, None))
            row[_PAPERS_RETURN] = value or "not published"
            row[Column("remark on the paper's")] = remark
        rows.append(row)
    note = (
        "A return is in its own reward's points: compare success, or the points that the human"
        f" reward gives the same episodes. {BEST.name.capitalize()}: of the evaluations on the way,"
        " of fewer episodes each; what the last has less was learnt and lost again."
        f" {SUCCESS_OVER_TRAINING.name.capitalize()}: of all training episodes."
        f" M steps: millions, until {100 * _SOON:.0f} % of the"
        f" training episodes succeed, over {BUFFERS} buffers; a number for each seed."
    )
    return Table.of("rewards", "Rewards: human, text, text + image", rows, note)


def soon(result: Result) -> list[float | str]:
    """Steps after which each run's training succeeds nearly always."""
    steps = [steps_to_share(run, "success", _SOON) for run in result.runs]
    return ["not reached" if one is None else one for one in steps]


def table_1(findings: StudyFindings) -> Table:
    """What the VLM answered, beside the shipped recordings' models and the paper's."""
    shown = []
    if findings.is_papers:
        shown = [*recorded_answers(), paper.answers()]
    if findings.study is not None and findings.answers and findings.answers.questions:
        shown.insert(0, findings.answers)
    said = [{answer.question: answer.answer for answer in one.questions} for one in shown]
    asked: Mapping[str, Any] = (
        said[-1] if findings.study is None else {q: None for one in said for q in one}
    )
    rows: list[Row] = [
        {
            Column("question"): question,
            **{Column(one.source): of.get(question) for one, of in zip(shown, said, strict=True)},
        }
        for question in asked
    ]
    return Table.of("table_1", "Table I: what the VLM answered", rows)


def table_2(findings: StudyFindings) -> Table:
    """Returns in each list, and the places that predictions and measurements give its sets."""
    results = {result.cameras: result for result in findings.ranked}
    rows: list[Row] = []
    for name, members in findings.lists.items():
        places = {Column(one.who): one.places(members) for one in findings.rankings}
        for cameras in findings.in_order(members):
            row: Row = {_LIST: LISTS.get(name, name), _CAMERAS: cameras}
            # The paper's own numbers are in the column that says so.
            if findings.study is not None:
                result = results.get(cameras)
                row |= _estimated(RETURN, result and result.value, "not run")
                row |= {Column.of(SUCCESS): result and result.success and result.success.value}
            if findings.is_papers:
                row[_PAPERS_RETURN] = paper.measured().get(cameras)
            for column, own in places.items():
                ranked = len(own) == len(members) or cameras not in own
                row[column] = own.get(cameras) if ranked else Of(own[cameras], len(own))
            rows.append(row)
    note = (
        "Place in the list, 1 the best; ties share their mean. Models that were asked repeatedly:"
        " by mean place. The probe cannot tell all of these apart: its own table has the intervals."
    )
    title = f"{'Table II: m' if findings.is_papers else 'M'}easured and predicted"
    if findings.study is None:
        title = "Table II, as published in the paper"
    return Table.of("table_2", title, rows, note)


_BRIER = Column("Brier", form=".2f")


def agreements(findings: StudyFindings) -> Table:
    """How well each prediction fits what was measured, here and in the paper, list by list."""
    rows: list[Row] = []
    for truth, values in findings.truths.items():
        for one in findings.predictions_of(truth):
            both: list[tuple[Mapping[str, float], Mapping[str, float]]] = []
            who: Row = {Column("prediction"): one.who, Column("against"): truth}
            for members, scores in one.lists.items():
                row = who | {_LIST: list_name(findings, members)}
                if not (missing := len(members - set(values))):
                    both.append((scores, {cameras: values[cameras] for cameras in members}))
                    brier = one.brier(members, values)
                    rows.append(row | agreed(agreement(*both[-1])) | {_BRIER: brier})
                elif truth == MEASURED:
                    remark = f"{missing} of {len(members)} not measured"
                    rows.append(row | agreed(None, remark) | {_BRIER: None})
            if len(both) > 1:
                row = who | {_LIST: "all lists"}
                rows.append(row | agreed(pooled(both)) | {_BRIER: None})
    note = (
        f"{TRAINING.name.capitalize()}: the mean of all training episodes, by steps, which says how"
        " soon cameras let the task be learnt. Two-sided permutation p-values. Regret: the return"
        " lost by taking the predicted best. All lists: means, with p by orders drawn for each list"
        " by itself. Brier: mean squared error of the probabilities that a model stated for"
        " neighbours in its order; 0.25 is that of knowing nothing."
    )
    return Table.of("agreement", "Agreement of predictions", rows, note)


def agreed(found: Agreement | None, remark: str = "") -> Row:
    """The columns of an agreement; without one, a remark in its place."""
    best: Cell = found and found.top_hit
    worst: Cell = found and found.bottom_hit
    if found and found.lists > 1:
        best, worst = Of(found.top_hits, found.lists), Of(found.bottom_hits, found.lists)
    return {
        Column("tau-b", form=".2f"): found and found.tau,
        Column("p of tau-b", form="p"): found and found.tau_p,
        Column("rho", form=".2f"): found and found.rho,
        Column("p of rho", form="p"): found and found.rho_p,
        Column("best found"): best,
        Column("worst found"): worst,
        Column("regret", form=".2f"): found.regret if found else remark,
    }


def list_name(findings: StudyFindings, members: Iterable[str]) -> str:
    """A list's name; a list that is not the paper's is named by what is in it."""
    names = {frozenset(own): LISTS.get(name) for name, own in findings.lists.items()}
    return names.get(frozenset(members)) or ", ".join(sorted(members))


def improvements(findings: StudyFindings) -> Table:
    """The chance that a run of the row's camera set beats one of the column's."""
    found = findings.by_set(RETURN)
    if findings.seeds < ENOUGH or len(found) < 2:
        found = {}
    rows: list[Row] = []
    for name, own in found.items():
        row: Row = {Column("better"): name}
        for other, theirs in found.items():
            row[replace(_RETURN, name=other)] = None if other == name else improvement(own, theirs)
        rows.append(row)
    note = "By final return. 95 % bootstrap intervals where both sets have five seeds or more."
    return Table.of("improvement", "Probability of improvement", rows, note)
