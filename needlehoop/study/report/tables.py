"""A study's tables: results, disturbances, the paper's Tables I and II, agreement."""

from __future__ import annotations

import numpy as np
import pandas as pd

from needlehoop.runs.files import ALL, NONE
from needlehoop.study.data import paper
from needlehoop.study.data.paper import reward_label, reward_order
from needlehoop.study.render.table import Table, p_value, percent, written
from needlehoop.study.stats.agreement import Agreement, agreement
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.predictions import MEASURED, recorded_answers
from needlehoop.study.stats.run import (
    BEST,
    BUFFERS,
    CHEAT,
    HUMAN_POINTS,
    SUCCESS_OVER_TRAINING,
    TRAINING,
    steps_to_success,
)
from needlehoop.study.stats.statistics import rate

_SOON = 0.9
"""Success in training from which on a reward has taught the task."""

TO_SOON = f"M steps to {100 * _SOON:.0f} %"

_SEVERITY = 3
"""Of disturbances that are summed up: what a lab or an operating room shows."""

_AGREEMENT = ("tau-b", "p of tau-b", "rho", "p of rho", "best found", "worst found", "regret")

Row = dict[str, str]
"""Cells by heading."""

RESULTS_NOTE = (
    "Means over seeds of final evaluations. Intervals are over three seeds or more; with fewer,"
    " Wilson's over all episodes, for shares alone. A return is in its own reward's points: across"
    " rewards, compare success, or the points that the human reward gives the same episodes. Over"
    " training: the mean of all training episodes, by steps. Success at best: of the evaluations"
    " on the way; what the last has less was learnt and lost again."
    f" {TO_SOON}: millions of steps until so many of the training episodes succeed, over"
    f" {BUFFERS} buffers for each seed. Last: shares of final episodes by the task's facts."
)


def all_tables(findings: StudyFindings) -> list[Table]:
    """Every table, some without rows."""
    return [table(findings) for table in (results, stress, table_1, table_2, agreements)]


def results(findings: StudyFindings) -> Table:
    """Every camera set with every reward: reward by reward, the best return first."""
    ordered = sorted(findings.results, key=lambda result: reward_order(result.reward))
    facts = dict.fromkeys(fact for run in findings.study.runs for _, fact in run.task.phases)
    rows = [
        result_row(result) | {f"{fact}, %": percent(result.middle(fact)) for fact in facts}
        for result in ordered
    ]
    return Table.of("results", "Results", rows, RESULTS_NOTE)


def result_row(result: Result) -> Row:
    """What the runs of one camera set with one reward came to."""
    steps = [steps_to_success(run, _SOON) for run in result.runs]
    return {
        "cameras": result.cameras,
        "reward": reward_label(result.reward),
        "seeds": str(result.value.seeds),
        "unfinished": str(result.unfinished),
        "return": written(result.value.value),
        "return, 95 %": written(result.value.interval_or_why),
        "success, %": percent(result.success.value),
        "success, 95 %": percent(result.success.interval_or_why),
        "cheat, %": percent(result.middle(CHEAT)),
        HUMAN_POINTS: written(result.middle(HUMAN_POINTS)),
        TRAINING: written(result.middle(TRAINING)),
        f"{SUCCESS_OVER_TRAINING}, %": percent(result.middle(SUCCESS_OVER_TRAINING)),
        f"{BEST}, %": percent(result.middle(BEST)),
        TO_SOON: written([one or "not reached" for one in steps], scale=1e-6),
    }


def stress(findings: StudyFindings) -> Table:
    """What disturbances cost each camera set, the least first."""
    rows = {}
    for result in findings.results:
        tested = [run.stress for run in result.runs if run.stress is not None]
        if not tested:
            continue
        rates = pd.concat(tested)
        rates = rates[rates["axis"].eq(NONE) | rates["severity"].eq(_SEVERITY)]
        shares = {str(axis): float(np.mean(one["success"])) for axis, one in rates.groupby("axis")}
        axes = [axis for axis in sorted(shares, key=shares.__getitem__) if axis not in (NONE, ALL)]
        parts = [part[part["axis"].isin(axes) & part["severity"].eq(_SEVERITY)] for part in tested]
        means = [float(np.mean(part["success"])) for part in parts]
        mean = rate(means, [int(np.sum(part["episodes"])) for part in parts])
        rows[mean.value, result.cameras, result.reward] = {
            "cameras": ", ".join(filter(None, (result.cameras, result.reward.partition("+")[2]))),
            "undisturbed, %": percent(shares[NONE]),
            f"severity {_SEVERITY}, %": percent(mean),
            "all at once, %": percent(shares.get(ALL)),
            "hurts most": ", ".join(f"{axis} {percent(shares[axis])} %" for axis in axes[:3]),
            "axes": str(len(axes)),
            "seeds": str(len(tested)),
        }
    note = (
        "Success of the mean action. Each axis of disturbance by itself, the mean over axes, with a"
        " 95 % interval; then all of them at once. docs/robustness.md says what each axis does."
    )
    return Table.of("stress", "Under disturbances", [rows[key] for key in sorted(rows)[::-1]], note)


def table_1(findings: StudyFindings) -> Table:
    """What the VLM answered, beside the shipped recordings' models and the paper's."""
    shown = [*recorded_answers(), paper.answers()] if findings.is_papers else []
    if findings.answers and findings.answers.questions:
        shown.insert(0, findings.answers)
    answers = {one.source: {row.question: row.answer for row in one.questions} for one in shown}
    rows = [
        {"question": question} | {name: cells.get(question, "") for name, cells in answers.items()}
        for question in dict.fromkeys(question for cells in answers.values() for question in cells)
    ]
    return Table.of("table_1", "Table I: what the VLM answered", rows)


def table_2(findings: StudyFindings) -> Table:
    """Returns in each list, and the places that predictions and measurements give its sets."""
    known = {result.cameras: result for result in findings.ranked}
    rows: list[Row] = []
    for name, members in findings.lists.items():
        places = {one.source: one.places(members) for one in findings.rankings}
        for cameras in members:
            cells = result_row(known[cameras]) if cameras in known else {"return, 95 %": "not run"}
            row = {"list": name, "cameras": cameras}
            row |= {key: cells.get(key, "") for key in ("return", "return, 95 %", "success, %")}
            if findings.is_papers:
                row["the paper's return"] = written(paper.measured().get(cameras))
            for source, ranked in places.items():
                of = f" of {len(ranked)}" if len(ranked) < len(members) else ""
                row[source] = f"{ranked[cameras]:g}{of}" if cameras in ranked else ""
            rows.append(row)
    note = (
        "Place in the list, 1 the best; ties share their mean. Models that were asked repeatedly:"
        " by mean place. The probe cannot tell all of these apart: its own table has the intervals."
    )
    return Table.of("table_2", "Measured and predicted", rows, note)


def agreements(findings: StudyFindings) -> Table:
    """How well each prediction fits what was measured, here and in the paper, list by list."""
    names = {frozenset(members): name for name, members in findings.lists.items()}
    rows: list[Row] = []
    for truth, values in findings.truths.items():
        for prediction in findings.predictions_of(truth):
            pair = {"prediction": prediction.source, "against": truth}
            both = []
            for members, scores in prediction.lists.items():
                row = pair | {"list": names.get(members) or ", ".join(sorted(members))}
                if missing := len(members - set(values)):
                    if truth == MEASURED:
                        empty = dict.fromkeys((*_AGREEMENT, "Brier"), "")
                        remark = {"regret": f"{missing} of {len(members)} not measured"}
                        rows.append(row | empty | remark)
                    continue
                both.append((scores, values))
                brier = {"Brier": written(prediction.brier(members, values))}
                rows.append(row | agreed(agreement(both[-1])) | brier)
            if len(both) > 1:
                rows.append(pair | {"list": "all lists"} | agreed(agreement(*both)) | {"Brier": ""})
    note = (
        "Two-sided permutation p-values. Regret: the return lost by taking the predicted best. All"
        " lists: means, with p by orders drawn for each list by itself. Brier: mean squared error"
        " of the probabilities that a model stated for neighbours; 0.25 is that of no knowledge."
    )
    return Table.of("agreement", "Agreement of predictions", rows, note)


def agreed(fit: Agreement) -> Row:
    """An agreement as a row's cells."""
    hits = fit.top_hits, fit.bottom_hits
    ends = [
        f"{count} of {fit.lists}" if fit.lists > 1 else "yes" if count else "no" for count in hits
    ]
    numbers = (written(fit.tau), p_value(fit.tau_p), written(fit.rho), p_value(fit.rho_p))
    return dict(zip(_AGREEMENT, (*numbers, *ends, written(fit.regret)), strict=True))
