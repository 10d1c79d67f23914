"""What a study found, camera set by camera set: what figures, tables and report show."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path
from statistics import mode

import numpy as np

from needlehoop.study.data import paper
from needlehoop.study.data.answers import Answers, read_answers
from needlehoop.study.data.contents import ALL, NONE, Stressed
from needlehoop.study.data.paper import HUMAN, reward_order
from needlehoop.study.data.records import LeftOut, Record, Study, read_study
from needlehoop.study.stats.predictions import (
    MEASURED,
    PAPERS_MEASURED,
    Prediction,
    lists_of,
    predictions,
    scored,
)
from needlehoop.study.stats.run import RETURN, TRAINING, Final, Measure, final
from needlehoop.study.stats.statistics import SeedEstimate, estimate, iqm, rate

SEVERITY = 3
"""The severity that is summed up: what a lab or an operating room shows."""


@dataclass(frozen=True)
class Result:
    """One camera set with one reward, over its seeds."""

    cameras: str
    reward: str
    runs: tuple[Record, ...]
    """Runs with a final value; none for the paper's."""
    finals: tuple[Final, ...]
    value: SeedEstimate
    """The final return."""
    success: SeedEstimate | None
    """``None`` where only returns were published."""
    cheat: SeedEstimate | None
    """``None`` as well where the task knows no cheats."""

    @property
    def unfinished(self) -> int:
        """Runs whose final value is of an agent still in training."""
        return sum(not found.finished for found in self.finals)

    def values(self, measure: Measure) -> list[float]:
        """A number of each run; empty where one run has no such number."""
        known = [one for found in self.finals if (one := measure.of(found)) is not None]
        return known if len(known) == len(self.finals) else []

    def middle(self, measure: Measure) -> float | None:
        """Its interquartile mean over seeds; ``None`` where a run has no such number."""
        own = self.values(measure)
        return float(iqm(np.array(own))) if own else None


@dataclass(frozen=True)
class StudyFindings:
    """A study, or the paper's numbers in a study's place."""

    title: str
    study: Study | None
    """``None``: the paper's."""
    results: tuple[Result, ...]
    """The best final return first."""
    answers: Answers | None
    """What the study's own model said."""
    predictions: tuple[Prediction, ...]
    """Of everyone who ranked camera sets, the study's own model among them."""
    left_out: tuple[LeftOut, ...]

    @property
    def is_papers(self) -> bool:
        """Whether the paper's numbers say something of it: its task, and one of its camera sets."""
        return self.study is None or _is_papers(self.study)

    @property
    def main_reward(self) -> str:
        """The reward under which cameras are compared: the human one, or the commonest."""
        rewards = [result.reward for result in self.results]
        return HUMAN if HUMAN in rewards or not rewards else mode(rewards)

    @property
    def goal(self) -> str:
        """The fact that says that the task is done; ``success`` where runs differ in it."""
        goals = {run.task.goal for result in self.results for run in result.runs}
        return goals.pop() if len(goals) == 1 else "success"

    @property
    def ranked(self) -> tuple[Result, ...]:
        """Results with the main reward, the best first."""
        return tuple(result for result in self.results if result.reward == self.main_reward)

    @property
    def by_reward(self) -> dict[str, list[Result]]:
        """Results by reward: first the one under which cameras are compared."""
        rewards = {result.reward for result in self.results}
        order = sorted(rewards, key=lambda own: (own != self.main_reward, reward_order(own)))
        return {own: [one for one in self.results if one.reward == own] for own in order}

    @property
    def lists(self) -> dict[str, tuple[str, ...]]:
        """The paper's lists, where they are of this study, then others that its VLM ranked."""
        return lists_of(self.answers, self.is_papers)

    @property
    def seeds(self) -> int:
        """The fewest seeds that a result has."""
        return min((result.value.seeds for result in self.results), default=0)

    def by_set(self, measure: Measure) -> dict[str, list[float]]:
        """A number of each run with the main reward, by camera set, the best final return first.

        Camera sets with a run that has no such number are left out.
        """
        return {one.cameras: own for one in self.ranked if (own := one.values(measure))}

    def middles(self, measure: Measure) -> dict[str, float]:
        """The same camera sets' interquartile means over seeds."""
        return {name: float(iqm(np.array(own))) for name, own in self.by_set(measure).items()}

    @property
    def truths(self) -> dict[str, Mapping[str, float]]:
        """What predictions are held against: values by camera set, by what they are."""
        found: dict[str, Mapping[str, float]] = {}
        if self.study is not None:
            found = {MEASURED: self.middles(RETURN), TRAINING.name: self.middles(TRAINING)}
        if self.is_papers:
            found[PAPERS_MEASURED] = paper.measured()
        return found

    @property
    def rankings(self) -> tuple[Prediction, ...]:
        """Predictions, then measurements."""
        found, lists = [*self.predictions], self.lists.values()
        for who, values in self.truths.items():
            one = scored(who, values, lists, whole=who == PAPERS_MEASURED)
            if one.lists or who != TRAINING.name:
                found.append(one)
        return tuple(found)

    def predictions_of(self, truth: str) -> list[Prediction]:
        """Those that are held against one of ``truths``; the paper's returns against ours."""
        found = [one for one in self.predictions if one.who != truth]
        if self.is_papers and truth in (MEASURED, TRAINING.name):
            found.append(scored(PAPERS_MEASURED, paper.measured(), paper.lists().values()))
        return found

    def in_order(self, members: Iterable[str]) -> list[str]:
        """A list's camera sets, the best first: as measured here, else in the paper."""
        chosen = tuple(members)
        ranked = {
            one.who: places
            for one in self.rankings
            if len(places := one.places(chosen)) == len(chosen)
        }
        by = ranked.get(MEASURED) or next(iter(reversed(ranked.values())), {})
        return sorted(chosen, key=lambda cameras: (by.get(cameras, math.inf), cameras))


@dataclass(frozen=True)
class Robustness:
    """Of one camera set with one reward, over the runs that were stressed."""

    result: Result
    success: dict[tuple[str, int], SeedEstimate]
    """By axis and severity, as far as all these runs were tested."""
    mean: SeedEstimate | None
    """Success at ``SEVERITY``, the mean over axes."""

    @property
    def name(self) -> str:
        """The cameras, and the label of runs that differ in another setting."""
        label = self.result.reward.partition("+")[2]
        return ", ".join(part for part in (self.result.cameras, label) if part)

    @property
    def undisturbed(self) -> SeedEstimate:
        """Success of the same episodes with nothing wrong."""
        return self.success[NONE, 0]

    @property
    def together(self) -> SeedEstimate | None:
        """Success with every axis at once."""
        return next((one for (axis, _), one in self.success.items() if axis == ALL), None)

    @property
    def axes(self) -> dict[str, SeedEstimate]:
        """Success at ``SEVERITY`` by axis, the worst first."""
        own = {key: one for key, one in self.success.items() if _summed(*key)}
        return {axis: own[axis, level] for axis, level in sorted(own, key=lambda k: own[k].value)}


def _summed(axis: str, severity: int) -> bool:
    return severity == SEVERITY and axis not in (NONE, ALL)


def robustness(findings: StudyFindings) -> list[Robustness]:
    """Every camera set with a stressed run, the best mean at ``SEVERITY`` first."""
    found = []
    for result in findings.results:
        runs = [run.stress for run in result.runs if run.stress]
        by: defaultdict[tuple[str, int], list[Stressed]] = defaultdict(list)
        for row in chain(*runs):
            by[row.axis, row.severity].append(row)
        success = {
            key: rate([row.success for row in own], [row.episodes for row in own])
            for key, own in by.items()
            if len(own) == len(runs)
        }
        if (NONE, 0) not in success:
            continue
        shown = {key for key in success if _summed(*key)}
        axes = [own for run in runs if (own := [r for r in run if (r.axis, r.severity) in shown])]
        shares = [float(np.mean([row.success for row in own])) for own in axes]
        episodes = [sum(row.episodes for row in own) for own in axes]
        found.append(Robustness(result, success, rate(shares, episodes) if shares else None))
    return sorted(found, key=lambda one: -(one.mean.value if one.mean else 0.0))


def study_findings(folder: Path) -> StudyFindings:
    """What the runs under a study's folder say.

    Raises:
        ValueError: no such folder.
    """
    study = read_study(folder)
    answers, unread = read_answers(folder)
    home = folder.resolve()
    papers = _is_papers(study)
    lists = [*lists_of(answers, papers).values()]
    foretold, unreadable = predictions(answers, home.parent, lists, home.name, papers)
    left_out = [*study.left_out, *unread, *unreadable]
    groups = groupby(study.runs, key=lambda run: (run.place.cameras, run.place.reward))
    results = [one for _, runs in groups if (one := result_of([*runs])) is not None]
    left_out += [
        LeftOut(run.folder.relative_to(folder), "not evaluated yet: it has no final value")
        for run in study.runs
        if final(run) is None
    ]
    return StudyFindings(home.name, study, _sorted(results), answers, foretold, tuple(left_out))


def _is_papers(study: Study) -> bool:
    sets = paper.measured()
    return study.is_of(paper.task()) and any(run.place.cameras in sets for run in study.runs)


def paper_findings(results: Path) -> StudyFindings:
    """The paper's Table I, Table II and Figure 7, where they are in numbers.

    In ``results``, the folder of all studies, is what else predicts the paper's order.
    """
    foretold, left_out = predictions(None, results, [*paper.lists().values()])
    values = {(name, HUMAN): value for name, value in paper.measured().items()}
    values |= {pair: value for pair, (value, _) in paper.rewards().items() if value is not None}
    found = [
        Result(cameras, reward, (), (), estimate([value]), None, None)
        for (cameras, reward), value in values.items()
    ]
    title = "the paper's numbers"
    return StudyFindings(title, None, _sorted(found), paper.answers(), foretold, tuple(left_out))


def _sorted(results: Sequence[Result]) -> tuple[Result, ...]:
    return tuple(sorted(results, key=lambda one: (-one.value.value, one.cameras, one.reward)))


def result_of(runs: Sequence[Record]) -> Result | None:
    """The result of runs with one camera set and one reward; ``None`` if none has a final value."""
    known = [(run, found) for run in runs if (found := final(run)) is not None]
    if not known:
        return None
    counted, finals = zip(*known, strict=True)
    episodes = [found.episodes for found in finals]
    cheats = [found.cheat for found in finals if found.cheat is not None]
    return Result(
        runs[0].place.cameras,
        runs[0].place.reward,
        counted,
        finals,
        value=estimate([found.value for found in finals]),
        success=rate([found.success for found in finals], episodes),
        cheat=rate(cheats, episodes) if len(cheats) == len(finals) else None,
    )
