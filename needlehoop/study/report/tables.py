"""A study's tables: results, where they fail, rewards, the paper's Tables I and II, agreement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.study.data import paper
from needlehoop.study.data.answers import Answers
from needlehoop.study.data.paper import LISTS, reward_label, reward_order
from needlehoop.study.render.table import Cell, Column, Estimated, Of, Table
from needlehoop.study.stats.agreement import Agreement, agreement, pooled
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.predictions import MEASURED, PAPERS_VLM, recorded_answers
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
from needlehoop.study.stats.statistics import ENOUGH, estimate, improvement, iqm, no_interval
from needlehoop.study.stats.stress import SEVERITY, robustness

_SOON = 0.9
"""Success in training from which on a reward has taught the task."""

_FINE = 0.95
"""Success from which on a camera set does not fail."""

_PAST = 0.05
"""Share of episodes that may come to a later phase's end and not to an earlier one's."""

_PERCENT: dict[str, Any] = {"form": ".0f", "scale": 100.0}
_POINTS: dict[str, Any] = {"form": ".2f"}


def all_tables(findings: StudyFindings) -> list[Table]:
    """Every table that has rows."""
    return [table for table in _every(findings) if table.rows]


def write_tables(findings: StudyFindings, folder: Path) -> list[Path]:
    """Write every table that has rows, as CSV, Markdown and LaTeX.

    Args:
        findings: of a study, or of the paper.
        folder: for the files; made where missing. Older tables there are replaced, or removed
            where they have no rows any more.
    """
    return [path for table in _every(findings) for path in table.write(folder)]


def _every(findings: StudyFindings) -> list[Table]:
    makers = (
        results,
        stress,
        phases,
        rewards,
        table_1,
        table_2,
        rankings,
        agreements,
        improvements,
    )
    return [maker(findings) for maker in makers]


def results(findings: StudyFindings) -> Table:
    """Every camera set with every reward: reward by reward, the best return first."""
    rows = []
    places: Counter[str] = Counter()
    for result in sorted(findings.results, key=lambda one: reward_order(one.reward)):
        places[result.reward] += 1
        rows.append(
            (
                places[result.reward],
                result.cameras,
                result.value.value,
                result.value.interval_or_why,
                result.middle(TRAINING),
                result.success and result.success.value,
                result.success and result.success.interval,
                result.cheat and result.cheat.value,
                reward_label(result.reward),
                result.value.seeds,
                result.unfinished,
            )
        )
    columns = (
        Column("place"), Column("cameras"), Column("return", **_POINTS),
        Column("return, 95 %", **_POINTS), Column.of(TRAINING), Column.share("success"),
        Column("success, 95 %", **_PERCENT), Column.share("cheat"), Column("reward"),
        Column("seeds"), Column("unfinished"),
    )  # fmt: skip
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
    return Table("results", "Results", columns, tuple(rows), note)


def stress(findings: StudyFindings) -> Table:
    """What disturbances cost each camera set, the least first."""
    rows = []
    for one in robustness(findings):
        hurts = [f"{axis} {100 * found.value:.0f} %" for axis, found in list(one.axes.items())[:3]]
        rows.append(
            (
                one.name,
                one.undisturbed.value,
                one.mean and Estimated(one.mean.value, one.mean.interval),
                one.together and one.together.value,
                ", ".join(hurts),
                len(one.axes),
                one.undisturbed.seeds,
            )
        )
    columns = (
        Column("cameras"), Column.share("undisturbed"), Column.share(f"severity {SEVERITY}"),
        Column.share("all at once"), Column("hurts most"), Column("axes"), Column("seeds"),
    )  # fmt: skip
    note = (
        "Success of the mean action. Each axis of disturbance by itself, the mean over axes, with a"
        " 95 % interval; then all of them at once. docs/robustness.md says what each axis does."
    )
    return Table("stress", "Under disturbances", columns, tuple(rows), note)


@dataclass(frozen=True)
class Reached:
    """Shares of a result's episodes, means over its seeds."""

    phases: tuple[tuple[str, str], ...]
    """Of its task: name, and the fact that ends it."""
    shares: Mapping[str, float | None]
    """By fact; ``None`` where runs under the same reward go past it."""

    @property
    def fails_in(self) -> str:
        """The phase in which most episodes end; empty where next to none fail."""
        lost: dict[str, float] = {}
        names: list[str] = []
        before = 1.0
        for name, fact in self.phases:
            names.append(name)
            share = self.shares[fact]
            if share is not None:
                lost[" and ".join(names)] = before - share
                names, before = [], share
        return "" if before >= _FINE else max(lost, key=lambda phase: lost[phase])


def reached(findings: StudyFindings) -> dict[tuple[str, str], Reached]:
    """How far each camera set came with each reward, if its task has phases."""
    shares = {
        (one.cameras, one.reward, phases): {
            fact: float(np.mean([found.shares[fact] for found in one.finals])) for _, fact in phases
        }
        for one in findings.results
        if (phases := _phases(one))
    }
    past = {
        (reward, phases, fact)
        for (_, reward, phases), own in shares.items()
        for number, fact in enumerate(own)
        if max([*own.values()][number:]) > own[fact] + _PAST
    }
    return {
        (cameras, reward): Reached(
            phases,
            {fact: None if (reward, phases, fact) in past else own[fact] for fact in own},
        )
        for (cameras, reward, phases), own in shares.items()
    }


def _phases(result: Result) -> tuple[tuple[str, str], ...]:
    """Of the task; none where seeds differ in it, because there is no mean over them."""
    found = {run.task.phases for run in result.runs}
    return found.pop() if len(found) == 1 else ()


def phases(findings: StudyFindings) -> Table:
    """How far each camera set came with each reward, in the order of results."""
    known = reached(findings)
    seeds = {(one.cameras, one.reward): one.value.seeds for one in findings.results}
    facts = dict.fromkeys(fact for one in known.values() for fact in one.shares)
    rows = [
        (
            cameras,
            *map(one.shares.get, facts),
            one.fails_in,
            reward_label(reward),
            seeds[cameras, reward],
        )
        for (cameras, reward), one in known.items()
    ]
    columns = (
        Column("cameras"), *map(Column.share, facts), Column("fails in"), Column("reward"),
        Column("seeds"),
    )  # fmt: skip
    note = (
        "Shares of final episodes, means over seeds. Fails in: the phase in which most episodes"
        f" end, where less than {100 * _FINE:.0f} % come to the end of the last."
    )
    if any(share is None for one in known.values() for share in one.shares.values()):
        note += (
            " A share is left empty under a reward that lets episodes go past it; there, the phase"
            " that it ends and the next are one."
        )
    return Table("phases", "Where they fail", columns, tuple(rows), note)


def rewards(findings: StudyFindings) -> Table:
    """Camera sets that were trained with several rewards, and each reward over all of them."""
    published = {(r.cameras, r.reward): r for r in paper.rewards()}
    written = {r.cameras for r in findings.results if r.reward != findings.main_reward}
    chosen = [r.cameras for r in findings.ranked if r.cameras in written]
    by_reward = sorted(findings.results, key=lambda r: reward_order(r.reward))
    # The last two columns are the paper's.
    own_columns = None if findings.is_papers else -2
    rows: list[tuple[Cell, ...]] = []
    for cameras in chosen:
        for result in by_reward:
            if result.cameras == cameras:
                theirs = published.get((cameras, result.reward))
                rows.append(
                    (
                        *_rewarded(cameras, [result]),
                        _times(result),
                        (theirs and theirs.value) or "not published",
                        theirs.remark if theirs else None,
                    )
                )
    for reward in dict.fromkeys(r.reward for r in by_reward):
        own = [r for r in findings.results if r.reward == reward and r.cameras in chosen]
        if len(chosen) > 1 and len(own) == len(chosen) and all(r.finals for r in own):
            rows.append((*_rewarded(f"all {len(own)}", own), None, None, None))
    columns = (
        Column("cameras"), Column("reward"), Column("return", **_POINTS),
        Column("return, 95 %", **_POINTS), Column.of(HUMAN_POINTS), Column.share("success"),
        Column("success, 95 %", **_PERCENT), Column.of(BEST), Column.share("cheat"),
        Column.of(SUCCESS_OVER_TRAINING),
        Column(f"M steps to {100 * _SOON:.0f} %", form=".2f", scale=1e-6),
        Column("the paper's return", **_POINTS), Column("remark on the paper's"),
    )  # fmt: skip
    note = (
        "A return is in its own reward's points: compare success, or the points that the human"
        f" reward gives the same episodes. {BEST.name.capitalize()}: of the evaluations on the way,"
        " of fewer episodes each; what the last has less was learnt and lost again."
        f" {SUCCESS_OVER_TRAINING.name.capitalize()}: of all training episodes."
        f" M steps: millions, until {100 * _SOON:.0f} % of the"
        f" training episodes succeed, over {BUFFERS} buffers; a number for each seed."
    )
    shown = tuple(row[:own_columns] for row in rows)
    title = "Rewards: human, text, text + image"
    return Table("rewards", title, columns[:own_columns], shown, note)


def _rewarded(name: str, found: Sequence[Result]) -> tuple[Cell, ...]:
    """A reward's numbers over one camera set, or over several, each of them a stratum."""
    one = found[0]
    if len(found) == 1:
        value, success, cheat = one.value, one.success, one.cheat
    else:
        value = estimate([r.values(RETURN) for r in found])
        success = estimate([r.values(SUCCESS) for r in found])
        cheats = [r.values(CHEAT) for r in found]
        cheat = estimate(cheats) if all(cheats) else None
    return (
        name,
        reward_label(one.reward),
        value.value,
        value.interval_or_why,
        _human(found),
        success and success.value,
        success and (success.interval or no_interval(success.seeds)),
        _over(found, BEST),
        cheat and cheat.value,
        _over(found, SUCCESS_OVER_TRAINING),
    )


def _over(found: Sequence[Result], measure: Measure) -> float | None:
    """The interquartile mean of all runs; ``None`` where one of them has no such number."""
    own = [result.values(measure) for result in found]
    return float(iqm(np.concatenate(own))) if all(own) else None


def _times(result: Result) -> Cell:
    """Steps until each run, by its seed, succeeds in ``_SOON`` of its episodes."""
    steps = [steps_to_share(run, "success", _SOON) for run in result.runs]
    return ["not reached" if one is None else one for one in steps]


def _human(found: Sequence[Result]) -> Cell:
    """The mean of the runs' points under the human reward; ``None`` where one has none.

    Points of another scene unit than today's default come with a remark.
    """
    finals = [final for result in found for final in result.finals]
    points = [final.human for final in finals if final.human is not None]
    if not points or len(points) < len(finals):
        return None
    mean = sum(points) / len(points)
    now = {_unit(run.task.name) for result in found for run in result.runs}
    others = {final.human_unit for final in finals if final.human_unit} - now
    said = " and ".join(f"{unit:g}" for unit in sorted(others))
    return f"{mean:.2f} (unit {said} m)" if others else mean


def _unit(task: str) -> float | None:
    """The scene unit of a shipped task's human reward, m; ``None`` where there is none."""
    path = CONF / f"reward/human/{task}.yaml"
    return read_yaml(path).get("unit") if path.is_file() else None


def table_1(findings: StudyFindings) -> Table:
    """What the VLM answered, beside the shipped recordings' models and the paper's."""
    shown = []
    if findings.is_papers:
        shown = [*recorded_answers(), Answers(PAPERS_VLM, paper.answers().questions)]
    if findings.study is not None and findings.answers and findings.answers.questions:
        shown.insert(0, findings.answers)
    said = [{answer.question: answer.answer for answer in one.questions} for one in shown]
    asked: Mapping[str, Any] = (
        said[-1] if findings.study is None else {q: None for one in said for q in one}
    )
    rows = tuple((question, *(one.get(question) for one in said)) for question in asked)
    columns = (Column("question"), *(Column(one.source) for one in shown))
    return Table("table_1", "Table I: what the VLM answered", columns, rows)


def table_2(findings: StudyFindings) -> Table:
    """Measured and predicted places in each list, ours and the paper's."""
    results = {result.cameras: result for result in findings.ranked}
    ours, published = findings.measured, paper.measured()
    said = _predicted(findings.answers) if findings.study is not None else {}
    papers = _predicted(paper.answers())
    rows: list[tuple[Cell, ...]] = []
    for name, members in findings.lists.items():
        own, theirs = _places(ours, members), _places(published, members)
        model, papers_model = said.get(frozenset(members), {}), papers.get(frozenset(members), {})
        far = len(members) + 1
        for cameras in sorted(members, key=lambda c: (own.get(c, far), theirs.get(c, far))):
            result = results.get(cameras)
            foretold, there = papers_model.get(cameras), theirs.get(cameras)
            rows.append(
                (
                    LISTS.get(name, name),
                    cameras,
                    _place(own, cameras, len(members)),
                    result and result.value.value,
                    result.value.interval_or_why if result else "not run",
                    result and result.success and result.success.value,
                    model.get(cameras),
                    there,
                    published.get(cameras),
                    foretold,
                    None if there is None or foretold is None else there < foretold,
                )
            )
    columns = (
        Column("list"), Column("cameras"), Column("place"), Column("return", **_POINTS),
        Column("95 %", **_POINTS), Column.share("success"), Column("VLM's place"),
        Column("the paper's place"), Column("the paper's return", **_POINTS),
        Column("the paper's VLM's place"), Column("better there than its VLM said"),
    )  # fmt: skip
    title = f"{'Table II: m' if findings.is_papers else 'M'}easured and predicted"
    keep = range(len(columns)) if findings.is_papers else range(7)
    if findings.study is None:
        # Its own numbers are in the columns that say so.
        keep, title = (0, 1, 7, 8, 9, 10), "Table II, as published in the paper"
    shown = tuple(tuple(row[i] for i in keep) for row in rows)
    return Table("table_2", title, tuple(columns[i] for i in keep), shown)


def _predicted(answers: Answers | None) -> dict[frozenset[str], Mapping[str, float]]:
    """Places by camera set of each ranked list, by its members."""
    rankings = answers.rankings if answers else ()
    return {frozenset(ranking.places): ranking.places for ranking in rankings}


def _places(values: Mapping[str, float], members: Sequence[str]) -> dict[str, int]:
    """Places of those members that have a value: 1 is the highest; ties share the best place."""
    known = {cameras: values[cameras] for cameras in members if cameras in values}
    return {
        cameras: 1 + sum(other > value for other in known.values())
        for cameras, value in known.items()
    }


def _place(places: Mapping[str, float], cameras: str, of: int) -> Cell:
    """A place; among so many only, where not all of a list has one."""
    if cameras in places and len(places) < of:
        return Of(places[cameras], len(places))
    return places.get(cameras)


def rankings(findings: StudyFindings) -> Table:
    """The place that each prediction and each measurement gives to each set of each list."""
    shown = findings.rankings
    rows = []
    for name, members in findings.lists.items():
        places = [one.places(members) for one in shown]
        rows += [
            (
                LISTS.get(name, name),
                cameras,
                *(_place(own, cameras, len(members)) for own in places),
            )
            for cameras in findings.in_order(members)
        ]
    note = (
        "Place in the list, 1 the best; ties share their mean. Models that were asked repeatedly:"
        " by mean place; imitation by success over its seeds. The probe cannot tell all of these"
        " apart: its own table has the intervals."
    )
    columns = tuple(map(Column, ("list", "cameras", *(one.who for one in shown))))
    return Table("rankings", "Rankings side by side", columns, tuple(rows), note)


def agreements(findings: StudyFindings) -> Table:
    """How well each prediction fits what was measured, here and in the paper, list by list."""
    rows: list[tuple[Cell, ...]] = []
    for truth, values in findings.truths.items():
        for one in findings.predictions_of(truth):
            both: list[tuple[Mapping[str, float], Mapping[str, float]]] = []
            for members, scores in one.lists.items():
                missing = len(members - set(values))
                if not missing:
                    both.append((scores, {cameras: values[cameras] for cameras in members}))
                    brier = one.brier(members, values)
                    said = (*_agreed(agreement(*both[-1])), brier)
                elif truth == MEASURED:
                    said = (*[None] * 6, f"{missing} of {len(members)} not measured", None)
                else:
                    continue
                rows.append((one.who, truth, list_name(members), *said))
            if len(both) > 1:
                rows.append((one.who, truth, "all lists", *_agreed(pooled(both)), None))
    columns = (
        Column("prediction"), Column("against"), Column("list"), Column("tau-b", form=".2f"),
        Column("p of tau-b", form="p"), Column("rho", form=".2f"), Column("p of rho", form="p"),
        Column("best found"), Column("worst found"), Column("regret", form=".2f"),
        Column("Brier", form=".2f"),
    )  # fmt: skip
    note = (
        f"{TRAINING.name.capitalize()}: the mean of all training episodes, by steps, which says how"
        " soon cameras let the task be learnt. Two-sided permutation p-values. Regret: the return"
        " lost by taking the predicted best; against imitation, the share of successes. All lists:"
        " means, with p by orders drawn for each list by itself."
    )
    if all(row[-1] is None for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    else:
        note += (
            " Brier: mean squared error of the probabilities that a model stated for neighbours in"
            " its order; 0.25 is that of knowing nothing."
        )
    return Table("agreement", "Agreement of predictions", columns, tuple(rows), note)


def _agreed(found: Agreement) -> tuple[Cell, ...]:
    hits = (found.top_hit, found.bottom_hit)
    if found.lists > 1:
        hits = (Of(found.top_hits, found.lists), Of(found.bottom_hits, found.lists))
    return (found.tau, found.tau_p, found.rho, found.rho_p, *hits, found.regret)


def list_name(members: frozenset[str]) -> str:
    """A list's name; a list that is not the paper's is named by what is in it."""
    for name, own in paper.lists().items():
        if frozenset(own) == members:
            return LISTS[name]
    return ", ".join(sorted(members))


def improvements(findings: StudyFindings) -> Table:
    """The chance that a run of the row's camera set beats one of the column's."""
    found = findings.ranked
    if findings.seeds < ENOUGH or len(found) < 2:
        none = no_interval(findings.seeds)
        return Table("improvement", "Probability of improvement", (), (), none)
    values = {one.cameras: [final.value for final in one.finals] for one in found}
    rows = []
    for name, own in values.items():
        chances = [None if other is own else improvement(own, other) for other in values.values()]
        rows.append((name, *(one and Estimated(one.value, one.interval) for one in chances)))
    columns = (Column("better"), *(Column(name, **_POINTS) for name in values))
    note = "By final return, with 95 % bootstrap intervals."
    return Table("improvement", "Probability of improvement", columns, tuple(rows), note)
