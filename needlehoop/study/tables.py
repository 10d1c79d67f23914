"""A study's tables: results, the paper's Tables I and II, rewards."""

from __future__ import annotations

import math
from collections.abc import Mapping

from needlehoop.study import paper
from needlehoop.study.agreement import Agreement, agreement
from needlehoop.study.answers import Answers, Ranking
from needlehoop.study.combinations import LISTS, REWARDS, label, reward_label
from needlehoop.study.findings import Findings, Result
from needlehoop.study.statistics import (
    ENOUGH,
    OVER_EPISODES,
    Estimate,
    estimate,
    improvement,
    no_interval,
)
from needlehoop.study.table import Table

_PAPERS = "the paper's"


def all_tables(findings: Findings) -> list[Table]:
    """Every table that has rows."""
    tables = [
        results(findings),
        table_1(findings),
        table_2(findings),
        agreements(findings),
        rewards(findings),
        improvements(findings),
    ]
    return [table for table in tables if table.rows]


def results(findings: Findings) -> Table:
    """Every combination with every reward, the best return first."""
    rows = []
    for place, result in enumerate(findings.results, start=1):
        rows.append(
            (
                str(place),
                label(result.cameras),
                f"{result.value.value:.2f}",
                result.value.interval,
                _percent(result.success),
                _interval(result.success),
                _percent(result.cheat),
                reward_label(result.reward),
                str(result.value.seeds),
                str(result.unfinished),
            )
        )
    head = ("place", "cameras", "return", "return, 95 %", "success, %", "success, 95 %")
    head += ("cheat, %", "reward")
    note = (
        "Interquartile means over seeds. Intervals are bootstrapped over three seeds or more;"
        " with fewer, Wilson's over all episodes, for rates alone."
    )
    if any(result.reward != findings.main_reward for result in findings.results):
        note += " A return is in its own reward's points: across rewards, compare success."
    if findings.study is None:
        note = "As the paper reports them: one run each, returns only."
    return Table("results", "Results", (*head, "seeds", "unfinished"), tuple(rows), note)


def table_1(findings: Findings) -> Table:
    """What the VLM answered, beside the paper's VLM."""
    published = {answer.question: answer.answer for answer in paper.answers().questions}
    head = ("question", f"{_PAPERS} VLM")
    rows = tuple(published.items())
    if findings.study is not None and findings.answers and findings.answers.questions:
        own = {answer.question: answer.answer for answer in findings.answers.questions}
        head = ("question", findings.answers.source, f"{_PAPERS} VLM")
        rows = tuple((question, own[question], published.get(question, "")) for question in own)
    return Table("table_1", "Table I: what the VLM answered", head, rows)


def table_2(findings: Findings) -> Table:
    """Measured and predicted places in each list, ours and the paper's."""
    measured, published = _measured(findings), paper.measured()
    said = _predicted(findings.answers) if findings.study is not None else {}
    papers = _predicted(paper.answers())
    rows = []
    for name, members in _lists(findings).items():
        own, theirs = _places(measured, members), _places(published, members)
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
                )
            )
    head = ("list", "cameras", "place", "return", "95 %", "success, %", "VLM's place")
    head += (f"{_PAPERS} place", f"{_PAPERS} return", f"{_PAPERS} VLM's place")
    title = "Table II: measured and predicted"
    if findings.study is None:
        # Its own numbers are in the columns that say so.
        keep = (0, 1, 7, 8, 9)
        head = tuple(head[i] for i in keep)
        rows = [tuple(row[i] for i in keep) for row in rows]
        title = "Table II, as published in the paper"
    return Table("table_2", title, head, tuple(rows))


def agreements(findings: Findings) -> Table:
    """How well each prediction fits what was measured, list by list."""
    published = paper.measured()
    papers = _predicted(paper.answers())
    sides: list[tuple[str, Mapping[frozenset[str], Mapping[str, float]], Mapping[str, float]]] = []
    if findings.study is not None:
        ours = _measured(findings)
        own = _predicted(findings.answers)
        theirs = {frozenset(m): {c: published[c] for c in m} for m in paper.lists().values()}
        sides += [
            ("VLM against measured", own, ours),
            (f"{_PAPERS} VLM against measured", papers, ours),
            (f"{_PAPERS} measured against measured", theirs, ours),
        ]
    sides.append((f"{_PAPERS} VLM against {_PAPERS} measured", papers, published))
    rows = []
    for what, predicted, measured in sides:
        for members, scores in predicted.items():
            name = _list_name(members)
            missing = [cameras for cameras in members if cameras not in measured]
            if missing:
                said = ("",) * 6 + (f"{len(missing)} of {len(members)} not measured",)
            else:
                said = _said(agreement(scores, {cameras: measured[cameras] for cameras in members}))
            rows.append((what, name, *said))
    head = ("what", "list", "tau-b", "p", "rho", "p", "best found", "worst found", "regret")
    note = "Two-sided permutation p-values; regret is the return lost by taking the predicted best."
    return Table("agreement", "Agreement of predictions", head, tuple(rows), note)


def rewards(findings: Findings) -> Table:
    """Combinations that were trained with a VLM's reward, beside the human one."""
    published = {(r.cameras, r.reward): r for r in paper.rewards()}
    written = {r.cameras for r in findings.results if r.reward != findings.main_reward}
    rows = []
    order = {name: i for i, name in enumerate(REWARDS)}
    chosen = [r for r in findings.ranked if r.cameras in written]
    for best in chosen:
        rivals = [r for r in findings.results if r.cameras == best.cameras]
        for result in sorted(rivals, key=lambda r: (order.get(r.reward, 99), r.reward)):
            theirs = published.get((result.cameras, result.reward))
            rows.append(
                (
                    label(result.cameras),
                    reward_label(result.reward),
                    f"{result.value.value:.2f}",
                    result.value.interval,
                    _percent(result.success),
                    _interval(result.success),
                    _percent(result.cheat),
                    f"{theirs.value:.2f}" if theirs else "not published",
                    theirs.remark if theirs else "",
                )
            )
    for reward in sorted({r.reward for r in findings.results}, key=lambda r: (order.get(r, 99), r)):
        own = [r for r in findings.results if r.reward == reward and r.cameras in written]
        if len(chosen) > 1 and len(own) == len(chosen) and all(r.finals for r in own):
            rows.append(_over_all(reward, own))
    head = ("cameras", "reward", "return", "return, 95 %", "success, %", "success, 95 %")
    head += ("cheat, %", f"{_PAPERS} return", "remark on the paper's")
    note = "A return is in its own reward's points: compare success."
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
        _percent(success),
        _interval(success),
        _percent(cheat),
        "",
        "",
    )


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


def _said(found: Agreement) -> tuple[str, ...]:
    return (
        *(_number(value) for value in (found.tau, found.tau_p, found.rho, found.rho_p)),
        "yes" if found.top_hit else "no",
        "yes" if found.bottom_hit else "no",
        f"{found.regret:.2f}",
    )


def _number(value: float) -> str:
    return "undefined" if math.isnan(value) else f"{value:.2f}"


def _measured(findings: Findings) -> dict[str, float]:
    return {result.cameras: result.value.value for result in findings.ranked}


def _result(findings: Findings, cameras: str) -> Result | None:
    return next((result for result in findings.ranked if result.cameras == cameras), None)


def _predicted(answers: Answers | None) -> dict[frozenset[str], dict[str, float]]:
    """Scores (higher is better) of each ranked list, by its members."""
    rankings: tuple[Ranking, ...] = answers.rankings if answers else ()
    return {
        frozenset(ranking.places): {name: -place for name, place in ranking.places.items()}
        for ranking in rankings
    }


def _lists(findings: Findings) -> dict[str, tuple[str, ...]]:
    """The paper's lists, then any others that the study's VLM ranked."""
    lists = dict(paper.lists())
    known = {frozenset(members) for members in lists.values()}
    for ranking in findings.answers.rankings if findings.answers else ():
        if frozenset(ranking.places) not in known:
            lists[f"list {len(lists) + 1}"] = tuple(ranking.places)
    return lists


def _list_name(members: frozenset[str]) -> str:
    for name, own in paper.lists().items():
        if frozenset(own) == members:
            return LISTS[name]
    return ", ".join(label(cameras) for cameras in sorted(members))


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


def _percent(found: Estimate | None) -> str:
    return "" if found is None else f"{100 * found.value:.0f}"


def _interval(found: Estimate | None) -> str:
    if found is None:
        return ""
    if found.low is None or found.high is None:
        return no_interval(found.seeds)
    told = f"{100 * found.low:.0f} to {100 * found.high:.0f}"
    return f"{told} ({OVER_EPISODES})" if found.over == OVER_EPISODES else told
